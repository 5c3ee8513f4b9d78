"""A body model as text, for info and fit."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

from .output import print_line


def show_body(found: dict[str, Any]) -> None:
    """Print a body model: samples, length scales, noise with standard errors, touch, provenance."""
    print_line(f"{found['path']}: body model of {', '.join(found['joints'])}")
    for name, sense in found["senses"].items():
        print_line(f"  {name} ({', '.join(sense['outputs'])}): {_sense_text(sense)}")
    for text in (
        *_zero_lines(found),
        *_noise_lines(found),
        *_touch_lines(found),
        *_provenance_lines(found["provenance"]),
    ):
        print_line(f"  {text}")


def _sense_text(sense: dict[str, Any]) -> str:
    if "coefficients" in sense:
        return "; ".join(
            " + ".join(f"{c:.4g} x^{k}" for k, c in enumerate(row)) for row in sense["coefficients"]
        )
    kernels = (
        ", ".join(f"{joint} {value:.4g}" for joint, value in one.items())
        for one in sense["length_scales"]
    )
    links = sense.get("kinematics")
    on = (
        ""
        if links is None
        else f"camera on {links['camera_link']}, marker on {links['marker_link']}; "
    )
    if "axes" in sense:
        on = f"axes in the order {', '.join(sense['axes'])}; "
    return f"{on}{sense['samples']} samples, length scales {'; '.join(kernels)} rad"


def _zero_lines(found: dict[str, Any]) -> Iterator[str]:
    """The joints' zeros in degrees and rad, their scales
    in percent, or the joints they are confused with.
    """
    offsets = found.get("offsets", {})
    scales = found.get("scales", {})
    named = [
        *((f"offset {k}", one) for k, one in offsets.items()),
        *((f"scale {k}", s) for k, s in scales.items()),
    ]
    for name, one in named:
        if one["value"] is None:
            yield f"{name}: not identifiable: {' and '.join(one['confused_with']) or 'not seen'}"
            continue
        if one["unit"] == "1":
            yield f"{name}: {100.0 * one['value']:+.2f} % ± {100.0 * one['std']:.2f} %"
            continue
        factor, unit = (math.degrees(1.0), "°") if one["unit"] == "rad" else (1e3, " mm")
        value, std = (factor * one[key] for key in ("value", "std"))
        plain = f"{one['value']:.5f} ± {one['std']:.2g} {one['unit']}"
        yield f"{name}: {value:+.2f}{unit} ± {std:.2f}{unit} ({plain})"


def _noise_lines(found: dict[str, Any]) -> Iterator[str]:
    """Standard deviations of measurements and densities
    of process noise, each with its standard error.
    """
    noise = found["noise"]
    errors = found["noise"]["std_error"]
    for joint, value, off in _names_with_errors(
        found["joints"], noise["encoder"], errors.get("encoder")
    ):
        yield f"noise encoders {joint}: {_std_text(value, off)} rad"
    for name, sense in found["senses"].items():
        for output, value, off in _names_with_errors(
            sense["outputs"], noise["senses"].get(name, ()), errors.get(name)
        ):
            yield f"noise {name} {output}: {_std_text(value, off)} {sense['unit']}"
    for joint, value, off in _names_with_errors(
        found["joints"], noise["process"], errors.get("process")
    ):
        yield f"process {joint}: {value:.4g}{_relative_error_text(off)} rad²/s³"


def _names_with_errors(
    names: Sequence[str], values: Sequence[float], errors: Sequence[float] | None
) -> Iterator[tuple[str, float, float | None]]:
    known = errors if errors is not None and len(errors) == len(values) else [None] * len(values)
    return zip(names, values, known, strict=False)


def _std_text(variance: float, off: float | None) -> str:
    """A standard deviation with its standard error."""
    std = variance**0.5
    return f"{std:.4g}{_relative_error_text(None if off is None else off / (2.0 * std))}"


def _relative_error_text(error: float | None) -> str:
    return "" if error is None else f" ± {error:.2g}"


def _touch_lines(found: dict[str, Any]) -> Iterator[str]:
    units = {"b1": " /px²", "b2": " /s²"}
    yield "touch: " + ", ".join(
        f"{name} = {value:.4g}{units.get(name, '')}" for name, value in found["touch"].items()
    )
    for cell, (u, v, spread) in found["cells"].items():
        yield f"cell {cell}: seen {u:+.1f}, {v:+.1f} px from the effector, spread {spread:.1f} px"


def _provenance_lines(values: dict[str, Any]) -> Iterator[str]:
    """The provenance of a body, without its settings: --json has these."""
    for key, value in sorted(values.items()):
        for item in () if key == "settings" else value if isinstance(value, list) else [value]:
            yield f"{key}: {' '.join(map(str, item)) if isinstance(item, list) else item}"

"""How results are shown: data on standard output, talk on standard error."""

import json
import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from bodylog.observed import Progress
    from bodylog.pipeline import Result
    from bodylog.types import Finding, Score

T = TypeVar("T")
R = TypeVar("R")


def show(result: "Result", as_json: bool, quiet: bool = False, **further: Any) -> int:
    """Print a result and return the exit code: 3 when part of the input was lost, else 0; `quiet` is for talk.

    What is `further` known of it is printed with --json alone.
    """
    talk(result.findings, quiet)
    if as_json:
        data(as_data(result) | further)
    else:
        table(() if quiet else result.scores)
        if result.output is not None:
            line(f"wrote {result.output}", err=True)
    return lost(result.findings)


def each(logs: Sequence[T], look: Callable[[T], R]) -> tuple[dict[str, R], int]:
    """What there is to tell of each log, by path; of one among others that is refused its line, and its exit code."""
    from bodylog.errors import InputError

    found, code = {}, 0
    for log in logs:
        try:
            found[str(log)] = look(log)
        except InputError as problem:
            if len(logs) == 1:
                raise
            say(problem)
            code = problem.exit_code
    return found, code


def say(problem: Exception) -> None:
    """A refusal, in one line on standard error; nothing where the process was told to end, which is why."""
    from bodylog.runtime import signals

    if not signals.received_signal():
        line(f"bodylog: {' '.join(str(problem).split())}", err=True)


def line(text: str, err: bool = False) -> None:
    """Print one line; signs that a terminal obeys, which names in a log may hold, as their codes."""
    plain = (c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in text)
    try:
        click.echo("".join(plain), err=err)
    except OSError:
        if not err:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())  # nobody hears what is said: the work goes on


def as_data(result: "Result") -> dict[str, Any]:
    """A result as the plain values of --json."""
    return {
        "output": None if result.output is None else str(result.output),
        "scores": [asdict(score) for score in result.scores],
        "health": {topic: asdict(health) for topic, health in result.health.items()},
        "findings": [asdict(finding) for finding in dict.fromkeys(result.findings)],
        "faults": [asdict(fault) for fault in result.faults],
        "settings": result.settings,
    }


def data(value: Any) -> None:
    """Print JSON; NaN, which JSON lacks, becomes null."""
    click.echo(json.dumps(_finite(value), indent=2, default=str))


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if hasattr(value, "tolist"):
        return _finite(value.tolist())
    return None if isinstance(value, float) and (value != value or abs(value) == float("inf")) else value


def talk(findings: "Sequence[Finding]", quiet: bool = False) -> None:
    """One line per finding, each once, on standard error; `quiet`: no mere information."""
    for finding in dict.fromkeys(findings):
        if not (quiet and finding.severity == "info"):
            line(f"{finding.severity}: {finding.text}", err=True)


def lost(findings: "Sequence[Finding]") -> int:
    """Exit code: 3 when part of the input was lost, else 0."""
    return 3 if any(finding.severity == "lost" for finding in findings) else 0


def table(scores: "Sequence[Score]") -> None:
    """Scores in columns."""
    width = max((len(score.name) for score in scores), default=0)
    for score in scores:
        line(f"{score.name:<{width}}  {score.value:>12.6g}  {score.unit}".rstrip())


def body(told: dict[str, Any]) -> None:
    """A body model as `info` tells it: samples and length scales, noise with standard errors, touch, where from."""
    line(f"{told['path']}: body model of {', '.join(told['joints'])}")
    for name, sense in told["senses"].items():
        line(f"  {name} ({', '.join(sense['outputs'])}): {_learned(sense)}")
    for text in (*_zeros(told), *_noise(told), *_touch(told), *_provenance(told["provenance"])):
        line(f"  {text}")


def _learned(sense: dict[str, Any]) -> str:
    if "coefficients" in sense:
        return "; ".join(" + ".join(f"{c:.4g} x^{k}" for k, c in enumerate(row)) for row in sense["coefficients"])
    kernels = (", ".join(f"{joint} {value:.4g}" for joint, value in one.items()) for one in sense["length_scales"])
    links = sense.get("kinematics")
    on = "" if links is None else f"camera on {links['camera_link']}, marker on {links['marker_link']}; "
    return f"{on}{sense['samples']} samples, length scales {'; '.join(kernels)} rad"


def _zeros(told: dict[str, Any]) -> Iterator[str]:
    """The joints' zeros in degrees and rad, their scales in percent, or what they cannot be told from."""
    offsets, scales = told.get("offsets", {}), told.get("scales", {})
    named = [*((f"offset {k}", one) for k, one in offsets.items()), *((f"scale {k}", s) for k, s in scales.items())]
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


def _noise(told: dict[str, Any]) -> Iterator[str]:
    """Standard deviations of what is read, and densities of the motion, each with its standard error."""
    noise, errors = told["noise"], told["noise"]["std_error"]
    for joint, value, off in _beside(told["joints"], noise["encoder"], errors.get("encoder")):
        yield f"noise encoders {joint}: {_root(value, off)} rad"
    for name, sense in told["senses"].items():
        for output, value, off in _beside(sense["outputs"], noise["senses"].get(name, ()), errors.get(name)):
            yield f"noise {name} {output}: {_root(value, off)} {sense['unit']}"
    for joint, value, off in _beside(told["joints"], noise["process"], errors.get("process")):
        yield f"process {joint}: {value:.4g}{_off(off)} rad²/s³"


def _beside(
    names: Sequence[str], values: Sequence[float], errors: Sequence[float] | None
) -> Iterator[tuple[str, float, float | None]]:
    known = errors if errors is not None and len(errors) == len(values) else [None] * len(values)
    return zip(names, values, known, strict=False)


def _root(variance: float, off: float | None) -> str:
    """A standard deviation, its standard error by the variance's."""
    std = variance**0.5
    return f"{std:.4g}{_off(None if off is None else off / (2.0 * std))}"


def _off(error: float | None) -> str:
    return "" if error is None else f" ± {error:.2g}"


def _touch(told: dict[str, Any]) -> Iterator[str]:
    units = {"b1": " /px²", "b2": " /s²"}
    yield "touch: " + ", ".join(f"{name} = {value:.4g}{units.get(name, '')}" for name, value in told["touch"].items())
    for cell, (u, v, spread) in told["cells"].items():
        yield f"cell {cell}: seen {u:+.1f}, {v:+.1f} px from the effector, spread {spread:.1f} px"


def _provenance(said: dict[str, Any]) -> Iterator[str]:
    """Where a body comes from; the settings, which are long, only with --json."""
    for key, value in sorted(said.items()):
        for item in () if key == "settings" else value if isinstance(value, list) else [value]:
            yield f"{key}: {' '.join(map(str, item)) if isinstance(item, list) else item}"


@contextmanager
def progress(what: str) -> "Iterator[Progress | None]":
    """A counter of pictures on a terminal, nothing otherwise; what is yielded is told how many more are done."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress as Bar
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn(f"{what}: {{task.completed:.0f}} pictures"), TimeElapsedColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda frames: bar.advance(task, frames)

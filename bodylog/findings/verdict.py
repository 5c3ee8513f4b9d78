"""The result of a command in a few sentences that a person can act on."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ..evaluation.figures import LEAST_OFFSETS, MEASURED_DELAYS, MISFIT, doubtful_delays
from ..fault_kinds import fault_sentence
from ..score_names import split_score_name
from ..types import HARDWARE_ERRORS, LASTING_ERROR, Estimate, Score
from ..wording import quantity_text

MAX_LISTED = 3
"""Faults, tracks or offsets that are written out; of more than one other the names."""
ERROR_BAR_TOLERANCE = 0.05
"""Share by which error bars may be too wide or too narrow and still be called true."""
_SHORTEST_DELAY = 1e-3
"""s: shorter camera delays are left out."""


def verdict_of_estimate(found: Estimate, scores: Sequence[Score]) -> tuple[str, ...]:
    """Faults, camera delays, senses without a fault, and
    the error, or the error bars where there is no truth.

    Of a log that does not fit the body, that alone.
    """
    if MISFIT in found.settings:
        return (str(found.settings[MISFIT]["text"]),)
    faults = [fault_sentence(fault) for fault in found.faults]
    sure = (
        *_first_lines(faults, "faults"),
        *_delay_sentences(found),
        *_lasting_error_sentences(found),
        *_hardware_error_sentences(found),
    )
    return (*sure, _agreement_sentence(found), *_error_sentences(found, scores))


def verdict_of_body(
    joints: Sequence[str],
    scores: Sequence[Score],
    placements: Sequence[str] = (),
    others: Sequence[str] = (),
) -> tuple[str, ...]:
    """Joints and tracks learned, held-out errors,
    calibration, joint zeros, and errors on test logs.

    placements: where cameras and markers are, in sentences · others: joints that were not learned.
    """
    values = {score.name: score.value for score in scores}
    left = f"; not over {', '.join(others)}; -v says why" if others else ""
    learned = f"learned over {_counted_noun(len(joints), 'joint')}: {', '.join(joints)}{left}"
    units = {score.name: score.unit for score in scores}
    errors = [
        _held_out_sentence(track, f"{value:.3g} {units[f'rmse/held_out/{track}']}", values)
        for track, value in _values_by_part(values, "rmse/held_out").items()
    ]
    offsets = [
        _zero_sentence(score, values)
        for score in scores
        if split_score_name(score.name)[0] == "offset"
    ]
    tests = [
        _test_log_sentence(track, f"{value:.3g} {units[f'rmse/test/{track}']}", values)
        for track, value in _values_by_part(values, "rmse/test").items()
    ]
    wrong = [one for one in offsets if one]
    placed = _first_lines(placements, "cameras and markers")
    return (
        learned,
        *_first_lines(errors, "tracks"),
        *placed,
        *_first_lines(wrong, "zeros", "; "),
        *tests[:1],
    )


def verdict_of_batch(rows: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """How many logs of a batch ended how, and the median and largest of their errors (rad)."""
    scored = {row["name"]: row["scores"].get("rmse/joint") for row in rows}
    errors = {name: error for name, error in scored.items() if error is not None}
    counts: dict[str, int] = {}
    for row in rows:
        counts[str(row["status"])] = counts.get(str(row["status"]), 0) + 1
    ended = ", ".join(f"{count} {status}" for status, count in counts.items())
    lines = [f"{_counted_noun(len(rows), 'log')}: {ended}"]
    if errors:
        worst = max(errors, key=lambda name: errors[name])
        middle = float(np.median(list(errors.values())))
        lines.append(
            f"error (RMSE): median {_angle_text(middle)}, largest "
            f"{_angle_text(errors[worst])} in {worst}"
        )
    return tuple(lines)


def _first_lines(lines: Sequence[str], what: str, joined: str | None = None) -> list[str]:
    """The first MAX_LISTED lines, and the names of the rest; a single one more is a line itself."""
    rest = lines[MAX_LISTED:]
    if len(rest) > 1:
        names = ", ".join(dict.fromkeys(line.partition(":")[0] for line in rest))
        rest = [f"{len(rest)} more {what}: {names}"]
    shown = [*lines[:MAX_LISTED], *rest]
    return [joined.join(shown)] if joined is not None and shown else shown


def _values_by_part(values: Mapping[str, float], figure: str) -> dict[str, float]:
    """The scores of one figure by part."""
    return {
        split_score_name(name)[1]: value
        for name, value in values.items()
        if split_score_name(name)[0] == figure
    }


def _delay_sentences(found: Estimate) -> Iterator[str]:
    """Camera delays that the estimate corrects, and those that are evident but in doubt."""
    known = found.settings.get("delay", {})
    for camera, delay in known.items() if isinstance(known, Mapping) else ():
        if abs(delay) >= _SHORTEST_DELAY:
            way = "late" if delay > 0 else "early"
            yield f"{camera}: timestamps are {abs(delay) * 1e3:.0f} ms {way}; corrected"
    for camera, delay, std, doubt in doubtful_delays(found):
        way = "late" if delay > 0 else "early"
        yield (
            f"{camera}: timestamps seem {abs(delay) * 1e3:.3g} ± {std * 1e3:.1g} ms {way}; not "
            f"corrected: {doubt}"
        )


def _lasting_error_sentences(found: Estimate) -> Iterator[str]:
    """Errors of encoders that last, by which error bars are widened."""
    own = found.settings.get(LASTING_ERROR)
    if isinstance(own, Mapping) and not own["nats"]:
        yield f"encoders: joints have play; error bars are wider by {1e3 * own['std']:.2g} mrad"
    elif isinstance(own, Mapping):
        size = f"{own['seconds']:.2g} s, {1e3 * own['std']:.2g} mrad"
        narrow = f"NEES about {own['nees_if_white']:.2g} without"
        yield f"encoders: errors last about {size}; error bars are wider for it ({narrow})"


def _hardware_error_sentences(found: Estimate) -> Iterator[str]:
    """Errors of joints, encoders and cameras that the angles allow for."""
    from ..estimation.factors.columns import describe_displacement
    from ..estimation.factors.load import describe_load

    errors = found.settings.get(HARDWARE_ERRORS)
    if not isinstance(errors, Mapping):
        return
    for joint, play in errors["play"].items():
        width, std = np.rad2deg([play["rad"], play["std"]])
        yield f"{joint}: {width:.2f} ± {std:.2f}° of play; corrected"
    if lasting := errors["lasting"]:
        size = f"{lasting['seconds']:.2g} s, {1e3 * lasting['std']:.2g} mrad"
        yield f"encoders: errors last {size}; angles and error bars allow for it"
    if slips := errors.get("slips"):
        sizes = ", ".join(f"{name} {np.rad2deg(size):.2g}°" for name, size in slips.items())
        yield f"joints stick and slip, by about {sizes} at once; angles follow the readings"
    for displaced in errors.get("displaced", ()):
        yield f"{describe_displacement(displaced)}; angles allow for it"
    if load := errors["load"]:
        yield f"{describe_load(load)}; angles and error bars allow for it"


def _list_read_encoders(found: Estimate) -> list[str]:
    """The joints whose encoder readings the estimate uses."""
    if "encoders" not in found.used or not found.used["encoders"].used:
        return []
    names = found.joints.names
    errors = found.errors.get("encoders")
    if errors is None:
        return list(names)
    columns = zip(names, errors.values.T, strict=True)
    return [name for name, column in columns if np.isfinite(column).any()]


def _agreement_sentence(found: Estimate) -> str:
    """The senses in which no fault is found, and which faults were not looked for."""
    faulty = {name for fault in found.faults for name in (*fault.names, fault.name)}
    errors = found.settings.get(HARDWARE_ERRORS)
    if isinstance(errors, Mapping):
        faulty |= {one["camera"] for one in errors.get("displaced", ())}
    tracks = [name for name, health in found.used.items() if health.used and name != "encoders"]
    sound = [
        name
        for name in tracks
        if name not in faulty and (name.rpartition("/")[0] or "camera") not in faulty
    ]
    encoders = [name for name in _list_read_encoders(found) if name not in faulty]
    if encoders:
        sound.insert(0, _counted_noun(len(encoders), "encoder"))
    listed = " and ".join([", ".join(sound[:-1]), sound[-1]] if sound[1:] else sound)
    text = f"no fault found in {listed or 'any sense'}"
    if not found.can.repairs:
        return f"{text}; {found.method} does not look for encoder offsets"
    if limits := found.settings.get(LEAST_OFFSETS):
        return f"{text}; {describe_least_offsets(limits)}"
    judged = (
        isinstance(found.settings.get(MEASURED_DELAYS), Mapping) and found.settings[MEASURED_DELAYS]
    )
    return (
        text if tracks or judged else f"{text}; without images, an encoder offset cannot be found"
    )


def describe_least_offsets(limits: Mapping[str, Any]) -> str:
    """Which offsets the robot's surface would not show: no error bar holds them."""
    shown = [
        f"{joint} {quantity_text(float(one['value']), None, one['unit'])}"
        for joint, one in limits.items()
        if one
    ]
    blind = [joint for joint, one in limits.items() if not one]
    parts = [f"of {', '.join(blind)} none would be found"] if blind else []
    if shown:
        parts.insert(0, f"smaller offsets than {', '.join(shown)} would not be found")
    return f"error bars hold no offset: {'; '.join(parts)}"


def _error_sentences(found: Estimate, scores: Sequence[Score]) -> Iterator[str]:
    values = {score.name: score.value for score in scores}
    if "rmse/joint" in values:
        raw = (
            f", raw encoders {_angle_text(values['rmse/encoders'])}"
            if "rmse/encoders" in values
            else ""
        )
        covered = f"; 2σ covers {values['coverage_2sigma/joint']:.1f} % of the truth"
        yield f"error (RMSE) {_angle_text(values['rmse/joint'])}{raw}{covered}"
    elif bar := typical_error_bar(found):
        yield f"no truth to compare with; typical 2σ error bar {bar}"
    if "rmse/effector_position" in values:
        yield f"effector position error (RMSE) {1e3 * values['rmse/effector_position']:.3g} mm"


def typical_error_bar(found: Estimate) -> str:
    """Two standard deviations of a joint at the median time and joint, "" without any belief."""
    if not len(found.cov):
        return ""
    typical = 2.0 * float(np.sqrt(np.median(np.einsum("nii->ni", found.cov))))
    return f"± {quantity_text(typical, None, _joint_unit(found))}"


def _angle_text(value: float) -> str:
    return quantity_text(value, None, "rad")


def _joint_unit(found: Estimate) -> str:
    """The unit of the joints: rad, unless the readings are counts or of an unknown unit."""
    return str(found.settings.get("joint_unit", "rad"))


def _held_out_sentence(track: str, error: str, values: Mapping[str, float]) -> str:
    bars = _error_bar_text(values.get(f"nis/held_out/{track}"))
    return f"{track}: error {error} on held-out parts of the log{bars}"


def _error_bar_text(nis: float | None) -> str:
    """How far error bars are from the errors that they are
    for, by the mean squared error in standard deviations.
    """
    if nis is None or not nis > 0.0:
        return ""
    factor = nis**-0.5
    if abs(factor - 1.0) < ERROR_BAR_TOLERANCE:
        return f"; its error bars are true to {100.0 * ERROR_BAR_TOLERANCE:.0f} % (NIS {nis:.2f})"
    way = "wide" if factor > 1.0 else "narrow"
    return f"; its error bars are {100.0 * abs(factor - 1.0):.0f} % too {way} (NIS {nis:.2f})"


def _zero_sentence(offset: Score, values: Mapping[str, float]) -> str | None:
    std = values.get(f"std/{offset.name}", 0.0)
    joint = split_score_name(offset.name)[1]
    size = quantity_text(offset.value, std, offset.unit, signed=True)
    return f"{joint}: zero is off by {size}" if abs(offset.value) > 2.0 * std else None


def _test_log_sentence(track: str, error: str, values: Mapping[str, float]) -> str:
    covered = values.get(f"coverage_2sigma/test/{track}", float("nan"))
    return f"{track}: error {error} on the test logs; 2σ covers {covered:.0f} %"


def _counted_noun(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"

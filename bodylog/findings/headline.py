"""The figures that a person looks for first: a report's cards, the columns of a batch's page."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..evaluation.figures import MISFIT, list_delays
from ..fault_kinds import fault_headline
from ..kinematics.identifiability import SHOWN
from ..robot.effector_poses import CALIBRATED
from ..score_names import split_score_name
from ..sources import group_of
from ..types import Estimate, Score
from ..wording import list_in_words, quantity_text
from .verdict import typical_error_bar

NAMES = (
    "faults",
    "error (RMSE)",
    "error bar (2σ)",
    "reprojection error (RMS)",
    "error of the calibration alone",
    "delay",
    "zeros off by more than 2σ",
)
"""What a headline may name, in this order: the error only where there is truth, that of the
calibration alone for still poses, zeros for a body with a URDF.
"""
UNKNOWN = "–"
"""What stands where a log does not tell a figure."""


def headline_of_estimate(found: Estimate, scores: Sequence[Score]) -> dict[str, str]:
    """Faults, error against the truth, error bar, reprojection error and delay, as short texts.

    The reprojection error is that of each sighting against its prediction before it.
    """
    values = {score.name: score.value for score in scores}
    error = quantity_text(values["rmse/joint"], None, "rad") if "rmse/joint" in values else None
    texts = (
        _faults_text(found),
        error,
        typical_error_bar(found) or UNKNOWN,
        _reprojection_text(values, _calibrated_groups(found)),
        _calibration_text(found),
        _delays_text(found),
        _zeros_text(found),
    )
    return {name: text for name, text in zip(NAMES, texts, strict=True) if text is not None}


def _faults_text(found: Estimate) -> str:
    if MISFIT in found.settings:
        return "not given: the log does not fit the body"
    return list_in_words([fault_headline(fault) for fault in found.faults]) or "none found"


def _reprojection_text(
    values: Mapping[str, float], groups: Mapping[str, Mapping[str, float]]
) -> str:
    """The error of each thing in px, and in mm where a URDF tells; of more than three the median
    and the largest. Points of one board are one thing.
    """
    squares = dict[str, list[float]]()
    for name, value in values.items():
        figure, track = split_score_name(name)
        if figure == "rmse/innovation" and np.isfinite(value):
            squares.setdefault(group_of(track), []).append(value**2)
    errors = {name: float(np.sqrt(np.mean(each))) for name, each in squares.items()}
    if len(errors) > 3:
        worst = max(errors, key=lambda name: errors[name])
        middle = float(np.median(list(errors.values())))
        return (
            f"{middle:.2g} px (median of {len(errors)} tracks), largest {errors[worst]:.2g} px "
            f"({worst})"
        )
    return ", ".join(_distance_text(name, errors[name], groups) for name in errors) or UNKNOWN


def _distance_text(name: str, px: float, groups: Mapping[str, Mapping[str, float]]) -> str:
    scale = groups.get(name, {}).get("mm_per_px")
    metric = "" if scale is None else f", {px * scale:.2g} mm"
    return f"{px:.2g} px{metric} ({name})"


def _calibrated_groups(found: Estimate) -> Mapping[str, Mapping[str, float]]:
    """What an estimate says of each board or marker; empty without a URDF, or where a file's
    mapping holds anything else.
    """
    groups = found.settings.get(CALIBRATED, {})
    if not isinstance(groups, Mapping):
        return {}
    return {
        name: {key: float(value) for key, value in one.items() if isinstance(value, int | float)}
        for name, one in groups.items()
        if isinstance(one, Mapping)
    }


def _calibration_text(found: Estimate) -> str | None:
    """The error of the calibration alone, of still poses; None otherwise."""
    groups = _calibrated_groups(found)
    texts = [_distance_text(name, one["px"], groups) for name, one in groups.items() if "px" in one]
    return ", ".join(texts) or None


def _zeros_text(found: Estimate) -> str | None:
    """Joints whose zero is off by more than two of its standard deviations; None without a URDF."""
    zeros = found.settings.get("offsets")
    if not isinstance(zeros, Mapping) or not zeros:
        return None
    texts = [
        f"{joint} {text}"
        for joint, one in zeros.items()
        if isinstance(one, Mapping) and (text := _zero_text(one)) is not None
    ]
    return ", ".join(texts) or "none"


def _zero_text(one: Mapping[str, Any]) -> str | None:
    value = one.get("value")
    std = one.get("std")
    if not isinstance(value, int | float) or not isinstance(std, int | float):
        return None
    factor, symbol = SHOWN.get(str(one.get("unit")), SHOWN["rad"])
    far = abs(value) > 2.0 * std
    return f"{factor * value:+.2f}{symbol} ± {factor * std:.2f}{symbol}" if far else None


def _delays_text(found: Estimate) -> str:
    """The delay of each camera ± its standard error if measured, and whether it is corrected."""
    applied = found.settings.get("delay", {})
    corrected = (
        {name for name, late in applied.items() if late} if isinstance(applied, Mapping) else set()
    )
    if found.settings.get("motion") == "none":
        return "none: the poses stand still"
    texts = []
    for score in list_delays(found):
        camera = split_score_name(score.name)[1]
        std = None if score.std is None else 1e3 * score.std
        done = "corrected" if camera in corrected else "not corrected"
        texts.append(f"{quantity_text(1e3 * score.value, std, 'ms')} ({camera}, {done})")
    return list_in_words(texts) or "not measured"

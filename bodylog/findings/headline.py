"""The figures that a person looks for first: a report's cards, the columns of a batch's page."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..evaluation.figures import MISFIT, list_delays
from ..fault_kinds import fault_headline
from ..score_names import split_score_name
from ..types import Estimate, Score
from ..wording import list_in_words, quantity_text
from .verdict import typical_error_bar

NAMES = ("faults", "error (RMSE)", "error bar (2σ)", "reprojection error (RMS)", "delay")
"""What a headline may name, in this order; the error only where there is truth."""
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
        _reprojection_text(values),
        _delays_text(found),
    )
    return {name: text for name, text in zip(NAMES, texts, strict=True) if text is not None}


def _faults_text(found: Estimate) -> str:
    if MISFIT in found.settings:
        return "not given: the log does not fit the body"
    return list_in_words([fault_headline(fault) for fault in found.faults]) or "none found"


def _reprojection_text(values: Mapping[str, float]) -> str:
    """The error of each track in px; of more than three the median and the largest."""
    errors = {
        split_score_name(name)[1]: v
        for name, v in values.items()
        if split_score_name(name)[0] == "rmse/innovation"
    }
    errors = {name: value for name, value in errors.items() if np.isfinite(value)}
    if len(errors) > 3:
        worst = max(errors, key=lambda name: errors[name])
        middle = float(np.median(list(errors.values())))
        return (
            f"{middle:.2g} px (median of {len(errors)} tracks), largest {errors[worst]:.2g} px "
            f"({worst})"
        )
    return ", ".join(f"{value:.2g} px ({name})" for name, value in errors.items()) or UNKNOWN


def _delays_text(found: Estimate) -> str:
    """The delay of each camera ± its standard error if measured, and whether it is corrected."""
    applied = found.settings.get("delay", {})
    corrected = (
        {name for name, late in applied.items() if late} if isinstance(applied, Mapping) else set()
    )
    texts = []
    for score in list_delays(found):
        camera = split_score_name(score.name)[1]
        std = None if score.std is None else 1e3 * score.std
        done = "corrected" if camera in corrected else "not corrected"
        texts.append(f"{quantity_text(1e3 * score.value, std, 'ms')} ({camera}, {done})")
    return list_in_words(texts) or "not measured"

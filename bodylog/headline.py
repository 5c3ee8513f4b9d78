"""The figures that a person looks for first: a report's cards, the columns of a batch's page."""

from collections.abc import Mapping, Sequence

import numpy as np

from .evaluation.figures import MISFIT, delays
from .score_names import split
from .types import Estimate, Fault, Score
from .verdict import typical_error_bar
from .wording import listed, quantity

NAMES = ("faults", "error (RMSE)", "error bar (2σ)", "reprojection error (RMS)", "delay")
"""What a headline may name, in this order; the error only where there is truth."""
UNKNOWN = "–"
"""What stands where a log does not tell a figure."""


def of_estimate(found: Estimate, scores: Sequence[Score]) -> dict[str, str]:
    """Faults, error against the truth, error bar, reprojection error and delay, as short texts.

    The reprojection error is that of each sighting against its prediction before it.
    """
    values = {score.name: score.value for score in scores}
    error = quantity(values["rmse/joint"], None, "rad") if "rmse/joint" in values else None
    texts = (
        _faults(found),
        error,
        typical_error_bar(found) or UNKNOWN,
        _reprojection(values),
        _delays(found),
    )
    return {name: text for name, text in zip(NAMES, texts, strict=True) if text is not None}


def _faults(found: Estimate) -> str:
    if MISFIT in found.settings:
        return "not told: the log does not fit the body"
    return listed([_fault(fault) for fault in found.faults]) or "none found"


def _fault(fault: Fault) -> str:
    sized = np.isfinite(fault.size) and fault.size != 0.0
    return (
        f"{fault.name} {fault.kind}"
        + f" by {quantity(fault.size, fault.std, fault.unit)}" * bool(sized)
    )


def _reprojection(values: Mapping[str, float]) -> str:
    """The error of each track in px; of more than three the median and the largest."""
    errors = {
        split(name)[1]: v for name, v in values.items() if split(name)[0] == "rmse/innovation"
    }
    errors = {name: value for name, value in errors.items() if np.isfinite(value)}
    if len(errors) > 3:
        worst = max(errors, key=lambda name: errors[name])
        middle = float(np.median(list(errors.values())))
        return f"{middle:.2g} px (median of {len(errors)} tracks), largest {errors[worst]:.2g} px ({worst})"
    return ", ".join(f"{value:.2g} px ({name})" for name, value in errors.items()) or UNKNOWN


def _delays(found: Estimate) -> str:
    """The delay of each camera ± its standard error if measured, and whether it is corrected."""
    applied = found.settings.get("delay", {})
    corrected = (
        {name for name, late in applied.items() if late} if isinstance(applied, Mapping) else set()
    )
    texts = []
    for score in delays(found):
        camera = split(score.name)[1]
        std = None if score.std is None else 1e3 * score.std
        done = "corrected" if camera in corrected else "not corrected"
        texts.append(f"{quantity(1e3 * score.value, std, 'ms')} ({camera}, {done})")
    return listed(texts) or "not measured"

"""Consistency of an estimate with its own log, without
ground truth: readings far from their predictions.
"""

from collections.abc import Iterator

import numpy as np

from ...settings import EstimationSettings
from ...types import Estimate, Finding
from ..measurements import long_arrays

OUTLIER_SIGMA = 3.0
"""Standard deviations: of readings with true variances at most 4/(9 FAR²), a twentieth, lie beyond,
however distributed about one peak (Vysochanskij and Petunin)."""
NOISY_STD_RAD = 0.1
"""rad: an encoder with more noise than this gets a warning."""


def consistency_findings(
    found: Estimate, settings: EstimationSettings, unit: str = "rad", rad_per_unit: float = 1.0
) -> Iterator[Finding]:
    """Yield a warning for each sense whose residuals
    exceed its error bars, and for each very noisy encoder.

    unit of the joints' readings, and its size in rad.
    """
    learned = found.settings.get("encoder", found.settings.get("sigma_encoders"))
    for name, variance in zip(
        found.joints.names, learned if isinstance(learned, list) else (), strict=False
    ):
        if (
            settings.precision == "auto"
            and settings.preset != "paper"
            and variance * rad_per_unit**2 > NOISY_STD_RAD**2
        ):
            text = (
                f"encoders: {name} has noise of {variance**0.5:.2g} {unit}; do two nodes publish "
                "on its topic?"
            )
            yield Finding("warning", text)
    for sense, errors in found.errors.items():
        off = np.abs(errors.values[np.isfinite(errors.values)]) > OUTLIER_SIGMA
        if len(off) > long_arrays.MIN_READINGS and off.mean() > 4.0 / (9.0 * OUTLIER_SIGMA**2):
            yield Finding(
                "warning",
                f"{sense}: {off.mean():.0%} of its readings are more than {OUTLIER_SIGMA:g} "
                "standard deviations from what was "
                "expected (0.3 % where error bars are true): "
                f"{_advise_on_inconsistency(found, settings, sense)}",
            )


def _advise_on_inconsistency(found: Estimate, settings: EstimationSettings, sense: str) -> str:
    """Likely cause, and what to type."""
    if not found.can.moves:
        return (
            f"{found.method} holds the arm still and detects no faulty encoder; type --method "
            "filter"
        )
    if settings.precision != "auto":
        return f"noise differs from that of --precision {settings.precision}; type --precision auto"
    if settings.bias == "off":
        return "an encoder may have an offset; type --bias auto"
    if sense == "encoders" and len(found.errors[sense].values) <= long_arrays.MIN_READINGS:
        return "readings are too few to learn their noise from"
    if sense == "encoders":
        return (
            "encoders or images are wrong for a while; see when with bodylog report, or type "
            "--without vision"
        )
    return (
        "outliers, or the camera moved since exploration; see with bodylog report, or type "
        f"--without {sense}"
    )

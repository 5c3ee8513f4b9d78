"""Whether encoder readings lie in the range, and have the unit, that the body was learned with."""

from collections.abc import Iterator
from dataclasses import replace
from math import tau

import numpy as np

from ...body_model import BodyModel
from ...errors import ModelError
from ...types import Array, Finding
from ..measurements.records import Evidence


def detect_out_of_range(evidence: Evidence, body: BodyModel) -> Evidence:
    """Check the range of all readings, unused encoders included: they give the initial belief."""
    return replace(evidence, findings=(*evidence.findings, *_range_findings(evidence.read, body)))


def _range_findings(readings: Array, body: BodyModel) -> Iterator[Finding]:
    """Yield a warning for each joint whose readings (N,M)
    rad are mostly out of range; ModelError for degrees.
    """
    known = [
        getattr(model, "samples", np.empty((0, len(body.joints)))) for model in body.senses.values()
    ]
    if "encoders" in body.senses or not len(
        explored := np.concatenate([np.empty((0, len(body.joints))), *known])
    ):
        return
    ranges = list(
        zip(body.joints, readings.T, explored.min(axis=0), explored.max(axis=0), strict=True)
    )
    beyond = [one for one in ranges if not _lies_in_explored_range(*one[1:])]
    wide = any(
        np.ptp(np.nanpercentile(y, [5, 95])) > max(tau, high - low) for _, y, low, high in beyond
    )
    if wide and all(
        _lies_in_explored_range(np.deg2rad(y), low, high) for _, y, low, high in ranges
    ):
        text = "; ".join(_ranges_text(*one) for one in beyond)
        raise ModelError(
            f'joints: {text}: these are degrees; type [body] unit = "deg" in robot.toml'
        )
    for name, y, low, high in beyond:
        turns = round(float(np.nanmedian(y) - (low + high) / 2.0) / tau)
        off = turns and _lies_in_explored_range(y - turns * tau, low, high)
        why = f"{turns:+d} whole turns off, home it again" if off else "beyond that"
        text = (
            f"joints: {_ranges_text(name, y, low, high)}: {why}, or fit a body from a log that "
            "explores it"
        )
        yield Finding("warning", f"{text}; images are of little use there")


def _lies_in_explored_range(readings: Array, low: float, high: float) -> bool:
    """Whether at least half of the finite values (N,) lie
    near the explored range; True if there are no values.

    Near is up to half of the range, and at least half a radian, beyond it.
    """
    readings = readings[np.isfinite(readings)]
    beside = 0.5 * max(1.0, high - low)
    return not len(readings) or bool(
        np.mean((readings >= low - beside) & (readings <= high + beside)) >= 0.5
    )


def _ranges_text(name: str, readings: Array, low: float, high: float) -> str:
    least, most = np.nanpercentile(readings, [5, 95])
    return (
        f"{name} reads {least:.4g} to {most:.4g} rad, the body was learned from {low:.4g} to "
        f"{high:.4g}"
    )

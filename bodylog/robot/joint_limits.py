"""Joint readings outside the limits of a URDF."""

from collections.abc import Iterator, Mapping
from math import tau
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FormatError
from ..settings import Settings
from ..types import Array, Finding, Series
from ..wording import list_in_words
from .model import joint_limits_of_log

if TYPE_CHECKING:
    from ..kinematics.robot import Limits

ENCODER_STEP_RAD = 2.0 * np.pi / 4096.0
"""rad: the step of a 12-bit encoder, assumed for one that never moves."""


def outside_limit_findings(log: Path, joints: Series, settings: Settings) -> Iterator[Finding]:
    """Remarks on joints beyond the limits of their URDF; the log's own URDF may be invalid."""
    try:
        yield from limit_findings(joints, *joint_limits_of_log(log, settings))
    except FormatError as problem:
        if settings.kinematics.urdf is not None:
            raise
        yield Finding("info", f"joints' limits are not known: {problem}")


def limit_findings(
    joints: Series, limits: "Mapping[str, Limits]", source: str
) -> Iterator[Finding]:
    """Yield remarks on joints that read outside their
    limits (rad, m); `source`: where the limits are from.

    Where units or zeros differ from the URDF's, no joint gets a warning. They differ if one joint
    is a whole turn beyond its limits, or if most joints are beyond theirs.
    """
    columns = dict(zip(joints.names, joints.values.T, strict=True))
    excess = {
        name: _excess_over_limits(y[np.isfinite(y)], limits[name])
        for name, y in columns.items()
        if name in limits
    }
    texts = dict[str, str]()
    typical = dict[str, float]()
    ranges = dict[str, float]()
    for name, beyond in excess.items():
        if (out := beyond > 0.0).any():
            own = limits[name]
            since = joints.t[np.isfinite(columns[name])][out][0]
            texts[name] = (
                f"{name}: {out.sum()} of {len(beyond)} readings outside of {own.lower:.4g} "
                f"to {own.upper:.4g} "
                f"{own.unit} ({source}), by up to {beyond.max():.3g} {own.unit}, first at "
                f"{since:.3f} s"
            )
            # single wild readings decide nothing about units
            typical[name] = float(np.quantile(beyond, 0.99))
            ranges[name] = own.upper - own.lower
    turned = any(typical[name] > tau and limits[name].unit == "rad" for name in texts)
    other = turned or 2 * len(texts) > max(len(excess), 2)
    foreign = [text for name, text in texts.items() if other or typical[name] > ranges[name]]
    yield from (
        Finding("warning", f"joints: {text}") for text in texts.values() if text not in foreign
    )
    if foreign:
        some = list_in_words(foreign, " joints", "; ")
        yield Finding(
            "info",
            f"joints: other units or zeros than those of {source}, or another robot's: {some}",
        )


def _excess_over_limits(y: Array, limits: "Limits") -> Array:
    """How far readings (N,) are beyond the limits; 0 within
    them, and where that is rounding or an encoder's step.
    """
    beyond = np.maximum(y - limits.upper, limits.lower - y)
    return np.where(beyond > limits.rounding + ENCODER_STEP_RAD, beyond, 0.0)

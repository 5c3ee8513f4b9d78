"""Joint readings outside the limits of a URDF."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import tau

import numpy as np

from ...kinematics.robot import Limits
from ...types import Array, Finding, Series
from .joints_alone import NAMED, STEP


@dataclass(frozen=True)
class _Outside:
    """A joint's readings beyond its limits: count, of how many, largest and 99 % quantile of the excess, since (s)."""

    name: str
    limits: Limits
    count: int
    readings: int
    worst: float
    typical: float
    since: float

    @property
    def of_another_unit(self) -> bool:
        """Whether the excess is larger than the range between the limits."""
        return self.typical > self.limits.upper - self.limits.lower


def limit_findings(joints: Series, limits: Mapping[str, Limits], source: str) -> Iterator[Finding]:
    """Yield remarks on joints that read outside their limits (rad, m); `source`: where the limits are from.

    Where units or zeros differ from the URDF's, no joint gets a warning. They differ if one joint is a whole turn
    beyond its limits, or if most joints are beyond theirs.
    """
    columns = dict(zip(joints.names, joints.values.T, strict=True))
    known = [_outside(name, limits[name], joints.t, columns[name]) for name in columns if name in limits]
    found = [one for one in known if one.count]
    turned = any(one.typical > tau and one.limits.unit == "rad" for one in found)
    other = turned or (len(found) > 1 and 2 * len(found) > len(known))
    foreign = [one for one in found if other or one.of_another_unit]
    for one in found:
        if one not in foreign:
            yield Finding("warning", f"joints: {_text(one, source)}")
    if foreign:
        some = "; ".join(_text(one, source) for one in foreign[:NAMED])
        more = f"; and {len(foreign) - NAMED} joints more" if len(foreign) > NAMED else ""
        yield Finding("info", f"joints: other units or zeros than those of {source}, or another robot's: {some}{more}")


def _outside(name: str, limits: Limits, t: Array, y: Array) -> _Outside:
    beyond = np.maximum(y - limits.upper, limits.lower - y)[np.isfinite(y)]
    out = beyond > limits.rounding + STEP
    if not out.any():
        return _Outside(name, limits, 0, len(beyond), 0.0, 0.0, 0.0)
    since = float(t[np.isfinite(y)][out][0])
    # single wild readings decide nothing about units
    worst, typical = np.quantile(beyond, [1.0, 0.99]).tolist()
    return _Outside(name, limits, int(out.sum()), len(beyond), worst, typical, since)


def _text(one: _Outside, source: str) -> str:
    lower, upper, unit = one.limits.lower, one.limits.upper, one.limits.unit
    return (
        f"{one.name}: {one.count} of {one.readings} readings outside of {lower:.4g} to {upper:.4g} {unit}"
        f" ({source}), by up to {one.worst:.3g} {unit}, first at {one.since:.3f} s"
    )

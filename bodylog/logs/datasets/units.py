"""The unit of a dataset's joints: as declared, or a guess from the values."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..joint_units import TURN, UNIT, ZERO
from ..records import Array

_WORDS = {
    "rad": "rad",
    "radian": "rad",
    "radians": "rad",
    "deg": "deg",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "tick": "counts",
    "ticks": "counts",
    "count": "counts",
    "counts": "counts",
    "raw": "counts",
    "steps": "counts",
}
_ENDING = re.compile(r"[._ (\[](?P<unit>[a-z]+)[)\]]?", re.IGNORECASE)
_COUNTS = 4096
"""Counts per turn of the 12-bit encoders of Feetech
STS and Dynamixel X servos: values run from 0 to 4095.
"""
_ROUND = 1.05
_SO_10X = re.compile(r"so[-_ ]?(arm)?[-_ ]?10[01]", re.IGNORECASE)
"""Robots of LeRobot's SO-ARM100 family by their type: their servos' calibration is public."""
_MIDDLE = 2048.0
"""Count at 0° of an SO-10x's joint: LeRobot's calibration centres the half turn there."""


@dataclass(frozen=True)
class Unit:
    """rad, deg, counts or unknown · whether the dataset declares it · one turn in that unit, None
    if unknown · the reading at 0 rad, None where counts have none that is known."""

    name: str
    declared: bool
    turn: float | None
    why: str
    zero: float | None = None

    @property
    def metadata(self) -> dict[str, str]:
        """The topic's metadata. A guess of rad adds none,
        as joints of any log are assumed to be in rad.
        """
        turn = {} if self.turn is None else {TURN: repr(self.turn)}
        turn |= {} if self.zero is None else {ZERO: repr(self.zero)}
        return {} if self.name == "rad" and not self.declared else {UNIT: self.name, **turn}

    @property
    def remark(self) -> tuple[str, str]:
        """Severity and text of the finding about the unit."""
        if self.name == "rad":
            return "info", f"joints: rad, {self.why}"
        if self.name == "deg" and self.declared:
            return "info", f"joints: degrees, {self.why}; they are read as rad"
        if self.zero is not None:
            reason = (
                "4096 are a turn and 2048 is 0°, as SO-10x arms have it; they are read as angles"
            )
            return "info", f"joints: encoder counts, {self.why}; {reason}"
        if self.name == "counts":
            advice = "they are kept as they are, so results in rad are in counts"
            return "warning", f"joints: encoder counts, {self.why}; {advice}"
        advice = 'if they are degrees, type: [body] unit = "deg"'
        return (
            "warning",
            f"joints: {self.why}; their unit is not declared and they are kept as they are; "
            f"{advice}",
        )


def guess_joint_unit(
    feature: Mapping[str, Any], names: Sequence[str], values: Array, robot: str = ""
) -> Unit:
    """The unit of joints from their feature's declaration, their names, and their values (N,K); of
    counts of a `robot` whose calibration is public, their zero as well."""
    found = _declared(feature, names, values)
    if found.name == "counts" and found.turn == _COUNTS and _SO_10X.search(robot):
        return replace(found, zero=_MIDDLE)
    return found


def _declared(feature: Mapping[str, Any], names: Sequence[str], values: Array) -> Unit:
    for key in ("unit", "units"):
        if isinstance(declared := feature.get(key), str) and (
            known := _WORDS.get(declared.strip().lower())
        ):
            return Unit(
                known,
                True,
                _turn_of_unit(known, values),
                f"as the dataset declares ({key}: {declared})",
            )
    endings = {
        _WORDS.get(match["unit"].lower()) if (match := _joint_unit_suffix(name)) else None
        for name in names
    }
    if len(endings) == 1 and (known := endings.pop()) is not None:
        return Unit(
            known,
            True,
            _turn_of_unit(known, values),
            f"as the names of the joints declare ({names[0]})",
        )
    return _guess_unit(values)


def _joint_unit_suffix(name: str) -> "re.Match[str] | None":
    """The unit at the end of a joint's name: elbow_deg, elbow (rad)."""
    found = list(_ENDING.finditer(name))
    return found[-1] if found and found[-1].end() == len(name) else None


def _guess_unit(values: Array) -> Unit:
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    seen = f"the values, {low:.4g} to {high:.4g}, look like it"
    if max(abs(low), abs(high)) <= _ROUND * 2 * math.pi:
        return Unit("rad", False, 2 * math.pi, seen)
    if low >= 0 and high > 360 and (known == np.round(known)).all():
        return Unit(
            "counts",
            False,
            _turn_of_unit("counts", values),
            f"whole numbers from {low:g} to {high:g}",
        )
    return Unit(
        "unknown", False, None, f"values from {low:.4g} to {high:.4g} are not angles in rad"
    )


def _turn_of_unit(name: str, values: Array) -> float | None:
    """One turn: for counts, only if the values fit a 12-bit encoder."""
    if name != "counts":
        return 2 * math.pi if name == "rad" else 360.0
    known = values[np.isfinite(values)]
    return (
        float(_COUNTS)
        if len(known) and known.min() >= 0 and 2 * np.pi < known.max() < _COUNTS
        else None
    )

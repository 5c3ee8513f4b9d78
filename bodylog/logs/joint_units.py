"""The unit of a topic's joints: from the topic's metadata, else from [body] unit."""

import math
import re
from collections.abc import Mapping
from typing import NamedTuple

UNIT = "bodylog.unit"
TURN = "bodylog.turn"
ZERO = "bodylog.zero"
"""Metadata of a joint topic: unit (rad, deg, counts or
unknown), the counts in one turn, and the count at 0 rad.
"""
SOURCE_UNIT = "bodylog.source_unit"
"""Metadata: unit that the joints had in their dataset before conversion to rad."""
_RAD = {"rad": 1.0, "deg": math.pi / 180.0}

_COUNTS = re.compile(
    r"([0-9]{1,9}(?:\.[0-9]{1,9})?) counts(?: from (-?[0-9]{1,12}(?:\.[0-9]{1,9})?))?"
)


def parse_count_unit(unit: str) -> tuple[float, float] | None:
    """Counts per turn and the count at 0 rad of a [body] unit; None for any other unit."""
    found = _COUNTS.fullmatch(unit)
    turn, zero = (0.0, 0.0) if found is None else (float(found[1]), float(found[2] or 0.0))
    return (turn, zero) if turn > 0.0 else None


class JointUnit(NamedTuple):
    """Unit of the readings · factor to convert them · unit
    after conversion · one turn in that unit, or None.

    `zero`: the reading at 0 rad. Encoder counts and unknown units are not converted unless the
    topic's metadata give turn and zero, or [body] unit does.
    """

    read: str
    factor: float
    unit: str
    turn: float | None
    zero: float = 0.0


def joint_unit(about: Mapping[str, str], settings_unit: str) -> JointUnit:
    """The joints' unit from their topic's metadata;
    `settings_unit` if these name none, or deg for an unknown one.
    """
    read = about.get(UNIT, settings_unit)
    given = parse_count_unit(settings_unit)
    if given is not None and read not in _RAD:
        return JointUnit("counts", 2.0 * math.pi / given[0], "rad", 2.0 * math.pi, given[1])
    if read == "unknown" and settings_unit == "deg":
        read = "deg"
    if read in _RAD:
        return JointUnit(read, _RAD[read], "rad", 2.0 * math.pi)
    turn = _parse_unit_number(about.get(TURN))
    zero = _parse_unit_number(about.get(ZERO))
    if read == "counts" and turn is not None and zero is not None:
        return JointUnit(read, 2.0 * math.pi / turn, "rad", 2.0 * math.pi, zero)
    return JointUnit(read, 1.0, read, turn)


def _parse_unit_number(text: str | None) -> float | None:
    try:
        found = float(text or "")
    except ValueError:
        return None
    return found if 0.0 < found < 1e9 else None

"""Check values from files: times and numbers in range, encodable texts, JSON of limited depth."""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

LATEST_NS = 1 << 62
"""ns, the year 2116: sums and differences of times up
to here fit int64, and ROS can write all times below.
"""

DEEPEST = 64
"""Levels of lists and tables: no message or header needs more, and recursion is safe up to here."""

_WIDEST = 1 << 63


def log_times_ns(ns: NDArray[Any]) -> NDArray[np.int64]:
    """Log times (n,) as int64 ns; times below 0 or beyond LATEST_NS become 0, which means unset.

    uint64 times may come as the int64 of the same bits.
    """
    found = ns.astype(np.int64, copy=False)
    if len(found) and (found.min() < 0 or found.max() > LATEST_NS):
        found = np.where((found < 0) | (found > LATEST_NS), 0, found)
    return found


def is_time(ns: int) -> bool:
    """Whether this log time (ns) is in a clock's range."""
    return 0 <= ns <= LATEST_NS


def stamp_ns(seconds: float | str, rest: float | str) -> int:
    """A stamp of seconds and nanoseconds in ns; 0 if it is not finite or beyond LATEST_NS."""
    try:
        found = int(seconds) * 1_000_000_000 + int(rest)
    except OverflowError:
        return 0
    return found if abs(found) <= LATEST_NS else 0


def number_in_64_bits(value: float) -> float:
    """A number in 64 bits: larger integers as floats, NaN if those overflow too."""
    if not isinstance(value, int) or -_WIDEST <= value < _WIDEST:
        return value
    try:
        return float(value)
    except OverflowError:
        return float("nan")


def encodable_text(value: str) -> str:
    """A text that can be encoded as UTF-8: lone surrogates become escapes."""
    return value if value.isascii() else value.encode(errors="backslashreplace").decode()


def read_json(data: str | bytes) -> Any:
    """The JSON value in a text; ValueError if it is invalid, or nested deeper than DEEPEST."""
    try:
        value = json.loads(data)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    opened = (
        data.count(b"[") + data.count(b"{")
        if isinstance(data, bytes)
        else data.count("[") + data.count("{")
    )
    if opened > DEEPEST and not _is_shallow(value):
        raise ValueError(f"nested more than {DEEPEST} deep")
    return value


def _is_shallow(value: Any) -> bool:
    """Whether lists and tables end within DEEPEST
    levels; checked level by level, without recursion.
    """
    level = [value]
    for _ in range(DEEPEST + 1):
        inner = (item for one in level for item in (one.values() if isinstance(one, dict) else one))
        level = [item for item in inner if isinstance(item, list | dict)]
        if not level:
            return True
    return False


FARTHEST = 1e9
"""rad: the largest credible joint angle; readings beyond are rejected."""


def reject_impossible(values: NDArray[Any]) -> tuple[NDArray[Any], int]:
    """Readings (N,D) with NaN for those beyond FARTHEST in any unit, and how many these were."""
    beyond = np.abs(values) > FARTHEST
    count = int(beyond.sum())
    return (np.where(beyond, np.nan, values) if count else values), count

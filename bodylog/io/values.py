"""What a file says, checked where it enters: times and numbers in range, texts to be written, JSON not too deep."""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

LATEST_NS = 1 << 62
"""ns, the year 2116: sums and differences of times up to here fit int64, and all that ROS can write lies below."""

DEEPEST = 64
"""Lists and tables in one another: no message or header needs more, and recursion is safe so far."""

_WIDEST = 1 << 63


def times(ns: NDArray[Any]) -> NDArray[np.int64]:
    """Log times (n,) as int64 ns; one that no clock shows (below 0 or beyond LATEST_NS) becomes 0, which dates nothing.

    uint64 times may come as the int64 of the same bits.
    """
    found = ns.astype(np.int64, copy=False)
    if len(found) and (found.min() < 0 or found.max() > LATEST_NS):
        found = np.where((found < 0) | (found > LATEST_NS), 0, found)
    return found


def is_time(ns: int) -> bool:
    """Whether a clock can show this log time (ns)."""
    return 0 <= ns <= LATEST_NS


def nanoseconds(seconds: float | str, rest: float | str) -> int:
    """A stamp of seconds and nanoseconds in ns; 0 where it is none, as it is not finite or beyond LATEST_NS."""
    try:
        found = int(seconds) * 1_000_000_000 + int(rest)
    except OverflowError:
        return 0
    return found if abs(found) <= LATEST_NS else 0


def number(value: float) -> float:
    """A number as 64 bits hold it: whole ones beyond them as floats, NaN where that is too large as well."""
    if not isinstance(value, int) or -_WIDEST <= value < _WIDEST:
        return value
    try:
        return float(value)
    except OverflowError:
        return float("nan")


def text(value: str) -> str:
    """A text that can be written as UTF-8: what cannot (half a surrogate pair) stands as its escape."""
    return value if value.isascii() else value.encode(errors="backslashreplace").decode()


def read_json(data: str | bytes) -> Any:
    """The JSON value in a text; ValueError where it is none, or more than DEEPEST lists lie in one another."""
    try:
        value = json.loads(data)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    opened = data.count(b"[") + data.count(b"{") if isinstance(data, bytes) else data.count("[") + data.count("{")
    if opened > DEEPEST and not _is_shallow(value):
        raise ValueError(f"nested more than {DEEPEST} deep")
    return value


def _is_shallow(value: Any) -> bool:
    """Whether lists and tables end within DEEPEST levels; level by level, so it takes no recursion."""
    level = [value]
    for _ in range(DEEPEST + 1):
        inner = (item for one in level for item in (one.values() if isinstance(one, dict) else one))
        level = [item for item in inner if isinstance(item, list | dict)]
        if not level:
            return True
    return False


FARTHEST = 1e9
"""rad: no joint has turned further; a reading beyond is none."""


def believed(values: NDArray[Any]) -> tuple[NDArray[Any], int]:
    """Readings (N,D) with NaN for what none reads, beyond FARTHEST in any unit, and how many these were."""
    beyond = np.abs(values) > FARTHEST
    count = int(beyond.sum())
    return (np.where(beyond, np.nan, values) if count else values), count

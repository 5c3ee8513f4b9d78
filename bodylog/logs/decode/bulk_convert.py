"""Convert ROS 1 messages of the same layout to CDR
all at once: one of them shows where each byte goes.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import FormatError
from ..encode.cdr import PRIMITIVES
from ..records import Array

_HEADER = "std_msgs/msg/Header"
_SIZES = {
    **{name: np.dtype(code).itemsize for name, code in PRIMITIVES.items()},
    "byte": 1,
    "char": 1,
    "octet": 1,
}
_LONGEST = 1 << 16
_NAMED = 2
_BASE = 1
_SEQUENCE = 4


def convert_same_layout(
    store: Any, kind: str, rows: Array, convert: Callable[[memoryview], memoryview]
) -> tuple[Array, Array]:
    """Which of the rows (n,L) uint8 have the layout
    of the first (n,) bool, and their CDR (m,K) uint8.

    `convert` turns one payload of that type into CDR; rosbags' type store
    gives the positions of lengths and texts. FormatError when the first
    row contradicts its type, or is longer than two bytes can count.
    """
    first = rows[0].tobytes()
    convert(memoryview(first))
    settled = np.zeros(len(first), bool)
    try:
        _mark_message(store, kind, first, 0, settled)
    except KeyError as problem:
        raise FormatError(f"{kind} has a field of type {problem}") from None
    if len(first) > _LONGEST:
        raise FormatError(f"{len(first)} bytes where at most {_LONGEST} are possible")
    same = (rows[:, settled] == rows[0, settled]).all(1)
    place = np.arange(len(first))
    probes = [
        _convert_pattern_message(rows[0], settled, digit, convert)
        for digit in (place & 255, ~place & 255, place >> 8)
    ]
    moved = probes[0] != probes[1]
    out = np.tile(probes[0], (int(same.sum()), 1))
    source = probes[0][moved].astype(np.int64) + 256 * probes[2][moved].astype(np.int64)
    out[:, moved] = rows[same][:, source]
    return same, out


def _convert_pattern_message(
    row: Array, settled: Array, digit: Array, convert: Callable[[memoryview], memoryview]
) -> Array:
    """The CDR of a message in which every byte that may vary holds a digit of its own position."""
    probe = np.where(settled, row, digit.astype(np.uint8))
    return np.frombuffer(convert(memoryview(probe.tobytes())), np.uint8)


def _mark_message(store: Any, kind: str, raw: bytes, at: int, settled: Array) -> int:
    """Mark lengths and texts of the message of type `kind` at byte `at`; returns its end."""
    at += 4 * (kind == _HEADER)
    for _, desc in store.fielddefs[kind][1]:
        at = _mark_field(store, desc, raw, at, settled)
    return at


def _mark_field(store: Any, desc: Any, raw: bytes, at: int, settled: Array) -> int:
    form, rest = desc
    if form == _NAMED:
        return _mark_message(store, rest, raw, at, settled)
    if form == _BASE:
        if rest[0] != "string":
            return at + _SIZES[rest[0]]
        end = at + 4 + int.from_bytes(raw[at : at + 4], "little")
        settled[at:end] = True
        return end
    inner = rest[0]
    count = int(rest[1])
    if form == _SEQUENCE:
        count = int.from_bytes(raw[at : at + 4], "little")
        settled[at : at + 4] = True
        at += 4
    if inner[0] == _BASE and inner[1][0] != "string":
        return at + count * _SIZES[inner[1][0]]
    for _ in range(count):
        at = _mark_field(store, inner, raw, at, settled)
    return at

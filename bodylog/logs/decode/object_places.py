"""Positions of values in JSON and protobuf messages:
a message of positions that message paths can follow.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...errors import FormatError
from ...io.values import LATEST_NS, encodable_text, number_in_64_bits, stamp_ns
from ..records import Array
from .message_path import Only, Step, is_index

SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos")
_MOST_REST_NS = 1_000_000_000_000_000
_LONGEST_S = (LATEST_NS + _MOST_REST_NS) // 1_000_000_000
"""With more seconds no such rest gives a time in
a clock's range; with fewer the sum fits 64 bits.
"""
Value = int | float | str | bytes
_SECONDS = ("sec", "secs", "seconds")
_NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos")


class Place:
    """A number of the message and its position; once a
    filter compares it, other messages must have it too.

    at, end: a range whose unit depends on the encoding · kind: the protobuf kind, 0 in JSON.
    """

    def __init__(
        self, value: float, at: int, end: int, kind: int, pinned: list[tuple[int, int]]
    ) -> None:
        """`pinned` gets the range when the value is compared."""
        self.value = value
        self.at = at
        self.end = end
        self.kind = kind
        self._pinned = pinned

    def __eq__(self, other: object) -> bool:
        """Whether the value equals `other`; pins it for all messages of this layout."""
        self._pinned.append((self.at, self.end))
        return bool(self.value == other)

    __hash__ = None  # type: ignore[assignment]


class Text(str):
    """A text of the message and its position; once
    compared or requested, other messages must have it too.
    """

    at: int
    end: int
    pinned: list[tuple[int, int]]

    def __eq__(self, other: object) -> bool:
        """Whether the text equals `other`; pins it for all messages of this layout."""
        self.pin()
        return str.__eq__(self, other)

    __hash__ = str.__hash__

    def pin(self) -> None:
        """Require other messages to have the same text."""
        self.pinned.append((self.at, self.end))


def text_at(value: str, at: int, end: int, pinned: list[tuple[int, int]]) -> Text:
    """The text at a position."""
    found = Text(value)
    found.at = at
    found.end = end
    found.pinned = pinned
    return found


class Opaque:
    """Bytes, which are neither compared nor read by position."""


class PlacedTime(NamedTuple):
    """A stamp in two places, or constants."""

    seconds: Any
    nanoseconds: Any


Item = Place | Text | PlacedTime | float | str | None
"""A value by its position, or one that the layout fixes."""


def list_plain_items(value: Any) -> Iterator[Item]:
    """The plain values below a value; KeyError for an
    object, FormatError where positions do not suffice.
    """
    if isinstance(value, dict):
        seconds = next((value[key] for key in SECONDS if key in value), None)
        if seconds is None:
            raise KeyError("an object, not a value")
        rest = next((value[key] for key in NANOSECONDS if key in value), 0)
        if not isinstance(seconds, Place | int) or not isinstance(rest, Place | int):
            raise FormatError("a time that is not made of two numbers")
        yield PlacedTime(seconds, rest)
    elif isinstance(value, list):
        for item in value:
            yield from list_plain_items(item)
    elif isinstance(value, Opaque):
        raise FormatError("bytes")
    else:
        if isinstance(value, Text):
            value.pin()
        yield value


Numbers = Callable[[Sequence[Place]], Array | None]
"""The numbers at places in every message, (n,K); None if one is missing or exceeds 64 bits."""


def number_of(steps: Sequence[Step]) -> int | None:
    """How many values a path gives at most: 1 if it ends at
    an element; 0 for a field, which may be one; else None.
    """
    if not all(isinstance(step, str) or is_index(step) for step in steps):
        return None
    return int(any(not isinstance(step, str) for step in steps))


def shape_values(values: Array, most: int | None) -> Array:
    """Values (n,K) in the path's shape: (n,) if it gives one alone, NaN for a missing element."""
    if most is None or values.shape[1] > 1:
        return values
    if values.shape[1] == 0:
        return np.full(len(values), np.nan) if most else values
    return values[:, 0]


def read_placed_column(
    found: Sequence[Item], single: int | None, count: int, numbers: Numbers
) -> Array | tuple[str, ...] | None:
    """One path's values in `count` messages, (n,) or (n,K),
    or its texts; None if they must be read one by one.
    """
    if any(isinstance(item, str) for item in found):
        plain = all(isinstance(item, str) for item in found)
        return tuple(str(item) for item in found) if plain else None
    parts: list[Array] = []
    at = 0
    while at < len(found):
        run = at
        while run < len(found) and isinstance(found[run], Place):
            run += 1
        part = numbers(found[at:run]) if run > at else _read_other_items(found[at], count, numbers)  # type: ignore[arg-type]
        if part is None:
            return None
        parts.append(part)
        at = max(run, at + 1)
    values = (
        parts[0]
        if len(parts) == 1
        else np.concatenate(parts, axis=1)
        if parts
        else np.empty((count, 0))
    )
    return shape_values(values, single)


def _read_other_items(item: Item, count: int, numbers: Numbers) -> Array | None:
    if not isinstance(item, PlacedTime):
        return np.full((count, 1), np.nan if item is None else item)
    seconds, rest = (
        _read_whole_numbers(part, count, numbers) for part in (item.seconds, item.nanoseconds)
    )
    if seconds is None or rest is None or abs(rest).max(initial=0) > _MOST_REST_NS:
        return None
    near = abs(seconds) <= _LONGEST_S
    found = np.where(near, seconds, 0) * 1_000_000_000 + np.where(near, rest, 0)
    return np.where(abs(found) <= LATEST_NS, found, 0)[:, None]


def _read_whole_numbers(part: Any, count: int, numbers: Numbers) -> Array | None:
    found = numbers([part]) if isinstance(part, Place) else np.full((count, 1), int(part))
    return found[:, 0] if found is not None and found.dtype == np.int64 else None


def follow_steps(
    value: Any, steps: tuple[Step, ...], plain: Callable[[Any], Iterator[Any]] | None = None
) -> Iterator[Any]:
    """The plain values at the end of the steps, times as ns; KeyError when a field is missing.

    `plain`: splits the final value into plain ones, in place of the default.
    """
    if not steps:
        yield from (plain or _plain_values)(value)
    elif isinstance(steps[0], str):
        yield from follow_steps(_plain_mapping(value)[steps[0]], steps[1:], plain)
    elif isinstance(steps[0], Only):
        if _plain_mapping(value).get(steps[0].field) == steps[0].value:
            yield from follow_steps(value, steps[1:], plain)
    else:
        for index in steps[0].of(len(_as_array(value))):
            yield from follow_steps(value[index], steps[1:], plain)


def _plain_mapping(value: Any) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise KeyError("not an object")
    return value


def _as_array(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise KeyError("not an array")
    return value


def _plain_values(value: Any) -> Iterator[Value]:
    if isinstance(value, dict):
        seconds = (
            next(value[key] for key in _SECONDS if key in value)
            if set(_SECONDS) & value.keys()
            else None
        )
        if seconds is None:
            raise KeyError("an object, not a value")
        yield stamp_ns(seconds, next((value[key] for key in _NANOSECONDS if key in value), 0))
    elif isinstance(value, list):
        if set(map(type, value)) == {float}:  # most arrays of a robot: nothing to convert
            yield from value
            return
        for item in value:
            yield from _plain_values(item)
    elif isinstance(value, str | bytes):
        yield encodable_text(value) if isinstance(value, str) else value
    else:
        yield float("nan") if value is None else number_in_64_bits(value)

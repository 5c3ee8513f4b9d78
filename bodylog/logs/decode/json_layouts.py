"""Decode JSON messages all at once that differ only in numbers, and in digits of texts that are not requested.

Numbers that are not requested are not parsed.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from ...errors import FormatError
from ...io.values import read_json
from ...io.values import text as encodable
from ..records import Array
from .decimals import POWER, numbers
from .message_path import Step
from .object_places import Item, Place, column, items, text

_TOKEN = re.compile(rb'"(?:[^"\\]|\\.)*"(\s*:)?|-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?', re.S)
_FIRST, _LAST = ord("-"), ord("9")
"""The bytes between them are number characters: the point, the digits, and the slash, so that two comparisons do."""

_SMALL = 0x20
"""The bit by which a lower-case letter differs from its capital."""

_IN_NUMBERS = bytes([ord("+"), *range(_FIRST, _LAST + 1)]) + POWER
Follow = Callable[..., Iterator[Item]]


def mark_runs(content: bytearray) -> Array | None:
    """Where runs of number characters begin and end in payloads, alternating (2n,) int64.

    The e of signed exponents, as writers emit them, is marked in `content` and belongs to its run. None if the content
    begins or ends with a run, or if the mark already occurs, which no JSON contains.
    """
    found = np.frombuffer(content, np.uint8)
    if found.min(initial=POWER[0] + 1) <= POWER[0]:
        return None
    inside = (found - _FIRST) <= _LAST - _FIRST
    if b"+" in content:
        inside |= found == ord("+")
    if not len(found) or inside[0] or inside[-1]:
        return None
    edges = np.flatnonzero(inside[1:] != inside[:-1])
    edges += 1
    return _joined_at_exponents(found, edges)


def _joined_at_exponents(content: Array, edges: Array) -> Array:
    """The edges of runs with those apart joined that only the e of an exponent separates; marks it."""
    apart = np.flatnonzero(edges[2::2] - edges[1:-1:2] == 1)
    at = edges[2 * apart + 1]
    sign = content[at + 1]
    power = ((content[at] | _SMALL) == ord("e")) & ((sign == ord("-")) | (sign == ord("+")))
    if not power.any():
        return edges
    content[at[power]] = POWER[0]
    kept = np.ones(len(edges), bool)
    kept[2 * apart[power] + 1] = kept[2 * apart[power] + 2] = False
    return edges[kept]


def skeleton(payload: bytearray) -> bytes:
    """A marked payload without its numbers."""
    return bytes(payload.translate(None, _IN_NUMBERS))


class JsonLayout:
    """The layout of one message and of all with the same skeleton."""

    def __init__(self, payload: bytes, runs: Array, paths: Sequence[tuple[Step, ...]], follow: Follow) -> None:
        """For a marked payload and its runs (2R,).

        FormatError, KeyError or ValueError when a path cannot be followed by position.
        """
        self._at, self._lengths = runs[0::2], runs[1::2] - runs[0::2]
        self._gaps = np.diff(runs, prepend=0)[0::2]
        self._pinned: list[tuple[int, int]] = []
        self._payload = payload
        value = self._shadow()
        self._items = [list(follow(value, steps, items)) for steps in paths]
        self._constant = self._constants()

    def values(
        self, content: bytearray, begin: Array, runs: Array, single: Sequence[int | None]
    ) -> list[Array | tuple[str, ...]] | None:
        """The paths' values in marked payloads of this skeleton: they begin at the bytes `begin` (n,) of `content`.

        `runs`: their runs (n,2R). None if one of them differs in more than numbers.
        """
        count = len(begin)
        if runs.shape[1] != 2 * len(self._at):
            return None
        starts, ends = runs[:, 0::2], runs[:, 1::2]
        if not self._fits(np.frombuffer(content, np.uint8), begin, starts, ends):
            return None

        def at(places: Sequence[Place]) -> Array | None:
            return self._numbers(content, starts, ends, [place.at for place in places])

        found: list[Array | tuple[str, ...]] = []
        for some, alone in zip(self._items, single, strict=True):
            values = column(some, alone, count, at)
            if values is None:
                return None
            found.append(values)
        return found

    def _shadow(self) -> Any:
        """The message with positions in place of its numbers and texts."""
        values, out, last = [], [], 0
        payload = self._payload.replace(POWER, b"e")
        for match in _TOKEN.finditer(payload):
            if match[1] is None:
                values.append((match.start(), match.end(), read_json(match[0])))
                form = b'"%d"' if match[0][:1] == b'"' else b" %d "  # apart, as 1-2 is not 12
                out += [payload[last : match.start()], form % (len(values) - 1)]
                last = match.end()
        shadow = read_json(b"".join([*out, payload[last:]]))
        if not isinstance(shadow, dict):
            raise FormatError("not an object")
        return self._placed(shadow, values)

    def _placed(self, value: Any, values: Sequence[tuple[int, int, Any]]) -> Any:
        if isinstance(value, dict):
            return {key: self._placed(inner, values) for key, inner in value.items()}
        if isinstance(value, list):
            return [self._placed(inner, values) for inner in value]
        if isinstance(value, str):
            at, end, known = values[int(value)]
            low, high = np.searchsorted(self._at, (at, end)).tolist()
            return text(encodable(known), low, high, self._pinned)
        if type(value) is int:
            at, end, known = values[value]
            run = int(np.searchsorted(self._at, at))
            if run == len(self._at) or self._at[run] != at or self._lengths[run] != end - at:
                raise FormatError("an exponent without a sign, or no number")
            return Place(known, run, run + 1, 0, self._pinned)
        return value

    def _constants(self) -> list[int]:
        """The runs that are equal in every message: keys, requested texts, compared values."""
        spans = [match.span() for match in _TOKEN.finditer(self._payload) if match[1]]
        keys = [np.searchsorted(self._at, span).tolist() for span in spans]
        escaped = [run for run, at in enumerate(self._at.tolist()) if b"\\" in self._payload[max(0, at - 5) : at]]
        return sorted({run for low, high in (*self._pinned, *keys) for run in range(low, high)} | set(escaped))

    def _fits(self, content: Array, begin: Array, starts: Array, ends: Array) -> bool:
        """Whether numbers are at the same positions between the same bytes, and constants are equal."""
        if (starts[:, :1] - begin[:, None] != self._gaps[:1]).any():
            return False
        if (starts[:, 1:] - ends[:, :-1] != self._gaps[1:]).any():
            return False
        for run in self._constant:
            length, at = int(self._lengths[run]), int(self._at[run])
            same = np.frombuffer(self._payload, np.uint8, length, at)
            if (ends[:, run] - starts[:, run] != length).any():
                return False
            if (content[starts[:, run, None] + np.arange(length)] != same).any():
                return False
        return True

    def _numbers(self, content: bytearray, starts: Array, ends: Array, runs: Sequence[int]) -> Array | None:
        """The numbers (n,K) in runs."""
        found = numbers(content, starts[:, runs].ravel(), ends[:, runs].ravel())
        return None if found is None else found.reshape(len(starts), len(runs))

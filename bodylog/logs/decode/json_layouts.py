"""Decode JSON messages all at once that differ only in numbers, and in digits of texts that are not requested.

Numbers that are not requested are not parsed.
"""

import math
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
_SMALL = 0x20
"""The bit by which a lower-case letter differs from its capital."""

_IN_NUMBERS = b"0123456789+-." + POWER
Follow = Callable[..., Iterator[Item]]


def marked(content: Array) -> bytes:
    """Payloads (bytes,) uint8 with the e of signed exponents marked, as writers emit them.

    Empty if the mark already occurs, which no JSON contains. Changes `content`.
    """
    if (content == POWER[0]).any():
        return b""
    letters = np.flatnonzero((content[:-1] | _SMALL) == ord("e"))
    following = content[letters + 1]
    content[letters[(following == ord("-")) | (following == ord("+"))]] = POWER[0]
    return content.tobytes()


def skeleton(payload: bytes) -> bytes:
    """A marked payload without its numbers."""
    return payload.translate(None, _IN_NUMBERS)


class JsonLayout:
    """The layout of one message and of all with the same skeleton."""

    def __init__(self, payload: bytes, paths: Sequence[tuple[Step, ...]], follow: Follow) -> None:
        """For a marked payload; FormatError, KeyError or ValueError when a path cannot be followed by position."""
        if b"\0" in payload:
            raise FormatError("UTF-16, where places are not between ASCII bytes")
        runs = _runs(payload)
        self._at, self._lengths = runs[0::2], runs[1::2] - runs[0::2]
        self._ranks = self._at - (np.cumsum(self._lengths) - self._lengths)
        self._pinned: list[tuple[int, int]] = []
        self._payload = payload
        value = self._shadow()
        self._items = [list(follow(value, steps, items)) for steps in paths]
        self._constant = self._constants()

    def values(
        self, content: bytes, begin: Array, single: Sequence[int | None]
    ) -> list[Array | tuple[str, ...]] | None:
        """The paths' values in marked payloads of this skeleton that begin at the bytes `begin` (n,) of `content`.

        None if one of them differs in more than numbers.
        """
        count, runs = len(begin), _runs(content)
        if len(runs) != 2 * count * len(self._at):
            return None
        starts, ends = np.moveaxis(runs.reshape(count, len(self._at), 2), 2, 0)
        if not self._fits(np.frombuffer(content, np.uint8), begin, starts, ends - starts):
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
                form = b'"%d"' if match[0][:1] == b'"' else b"%d"
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
        if isinstance(value, float) and math.isfinite(value):
            raise FormatError("no number, as something follows it")
        return value

    def _constants(self) -> list[int]:
        """The runs that are equal in every message: keys, requested texts, compared values."""
        spans = [match.span() for match in _TOKEN.finditer(self._payload) if match[1]]
        keys = [np.searchsorted(self._at, span).tolist() for span in spans]
        escaped = [run for run, at in enumerate(self._at.tolist()) if b"\\" in self._payload[max(0, at - 5) : at]]
        return sorted({run for low, high in (*self._pinned, *keys) for run in range(low, high)} | set(escaped))

    def _fits(self, content: Array, begin: Array, starts: Array, lengths: Array) -> bool:
        """Whether numbers are at the same positions between the same bytes, and constants are equal."""
        before = np.cumsum(lengths, axis=1) - lengths
        if (starts - begin[:, None] - before != self._ranks).any():
            return False
        for run in self._constant:
            length, at = int(self._lengths[run]), int(self._at[run])
            same = np.frombuffer(self._payload, np.uint8, length, at)
            if (lengths[:, run] != length).any() or (content[starts[:, run, None] + np.arange(length)] != same).any():
                return False
        return True

    def _numbers(self, content: bytes, starts: Array, ends: Array, runs: Sequence[int]) -> Array | None:
        """The numbers (n,K) in runs."""
        found = numbers(content, starts[:, runs].ravel(), ends[:, runs].ravel())
        return None if found is None else found.reshape(len(starts), len(runs))


def _runs(content: bytes) -> Array:
    """Where runs of number characters begin and end, alternating (2n,); none may touch the ends."""
    found = np.frombuffer(content, np.uint8)
    # Comparing bytes is faster than a lookup table: from - to 9 are the point, the slash and the digits.
    inside = ((found - ord("-")) <= ord("9") - ord("-")) & (found != ord("/"))
    inside |= (found == ord("+")) | (found == POWER[0])
    if not len(content) or inside[0] or inside[-1]:
        raise FormatError("it begins or ends with a number")
    return np.flatnonzero(inside[1:] != inside[:-1]) + 1

"""Read rows of rosbag2's messages from SQLite's pages in bulk; SQLite itself returns them one by one.

Format: https://www.sqlite.org/fileformat2.html. Tables unlike those that rosbag2 writes are left to SQLite.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ...errors import FormatError
from ..decode.gather import gather
from ..records import Array
from ..storage.mmapped import advise_sequential, drop_pages

_INTERIOR, _LEAF = 5, 13
_HEAD = {_INTERIOR: 12, _LEAF: 8}
_FIRST_HEAD = 100
_DEEPEST = 20
_SHORT = 64 << 20
"""Bytes of a database whose rows are kept once they are read: they are counted first."""

_TOGETHER = 256
_VARINT, _EIGHT, _WINDOW = 8, 8, 24
_SIZES = np.array([0, 1, 2, 3, 4, 6, 8, 0, 0, 0], np.int64)
"""Bytes of an integer by its serial type; 7 is a float, so it has none."""

_FLOAT, _ZERO, _ONE, _BLOB = 7, 8, 9, 12
_OVERFLOW = 35


class Rows(NamedTuple):
    """Rows in order: rowid, topic id in the file, log time (ns), and where in the file each payload is; all (n,)."""

    rowid: Array
    topic: Array
    log_ns: Array
    offset: Array
    length: Array


class Pages:
    """The mapped pages of a database that nobody writes to."""

    def __init__(self, data: memoryview, root: int) -> None:
        """The table whose b-tree begins at page `root`; FormatError when the file must be read by SQLite."""
        self._view, self.data = data, np.frombuffer(data, np.uint8)
        size = int.from_bytes(data[16:18], "big")
        self._size = 1 << 16 if size == 1 else size
        self._usable = self._size - data[20]
        self._count = len(data) // max(1, self._size)
        if self._size < 512 or self._size & (self._size - 1) or self._usable < 480:
            raise FormatError(f"pages of {self._size} bytes")
        self._root = root
        self.short = len(data) <= _SHORT
        self._kept: list[Rows] | None = None

    def rows(self) -> Iterator[Rows]:
        """All rows in order, some pages at a time; FormatError at the first page that SQLite must read."""
        if self._kept is not None:
            yield from self._kept
            return
        kept = []
        for found in self._rows():
            yield found
            kept += [found] if self.short else []
        self._kept = kept if self.short else None

    def _rows(self) -> Iterator[Rows]:
        leaves = self._leaves()
        last = -(1 << 63)
        for at in range(0, len(leaves), _TOGETHER):
            found = self._read(leaves[at : at + _TOGETHER])
            if len(found.rowid):
                if found.rowid[0] <= last or (found.rowid[1:] <= found.rowid[:-1]).any():
                    raise FormatError("rows that go back")
                last = int(found.rowid[-1])
                yield found

    def _leaves(self) -> Array:
        """The numbers of the leaf pages in order."""
        level, seen = np.array([self._root], np.int64), 0
        for _ in range(_DEEPEST):
            seen += len(level)
            if (level < 2).any() or (level > self._count).any() or seen > self._count:
                raise FormatError("a page that is not there")
            if self.data[(level[0] - 1) * self._size] == _LEAF:
                return level
            level = np.concatenate([self._children(page) for page in level.tolist()])
        raise FormatError("too deep a tree")

    def _children(self, page: int) -> Array:
        base = (page - 1) * self._size
        cells, _ = self._cells(np.array([base]), _INTERIOR)
        return np.append(self._number(cells, 4), self._number(np.array([base + 8]), 4))

    def _cells(self, base: Array, kind: int) -> tuple[Array, Array]:
        """Where the cells of pages that begin at `base` (p,) are, and where each cell's page ends."""
        if (self.data[base] != kind).any():
            raise FormatError("leaves of several depths, or another kind of tree")
        counts = self._number(base + 3, 2)
        bases = np.repeat(base, counts)
        number = np.arange(len(bases)) - np.repeat(np.cumsum(counts) - counts, counts)
        if (_HEAD[kind] + 2 * counts > self._usable).any():
            raise FormatError("more cells than a page has room for")
        pointer = self._number(bases + _HEAD[kind] + 2 * number, 2)
        if (pointer < _HEAD[kind] + 2 * np.repeat(counts, counts)).any() or (pointer > self._usable - 4).any():
            raise FormatError("a cell outside its page")
        return bases + pointer, bases + self._usable

    def _read(self, leaves: Array) -> Rows:
        base = (leaves - 1) * self._size
        low, high = int(base.min()), int(base.max()) + self._size
        if high - low <= 4 * self._size * len(leaves):
            advise_sequential(self._view, low, high)
        at, end = self._cells(base, _LEAF)
        (size, rowid, *header), places = self._varints(at, end, 7)
        at = places[1]
        if (size > self._usable - _OVERFLOW).any() or (at + size > end).any():
            raise FormatError("payloads that go on elsewhere")
        body, (topic, timestamp, blob) = places[-1], _checked(header, places[-1] - at)
        sizes = _SIZES[topic], _SIZES[timestamp]
        length = (blob - _BLOB) // 2
        offset = body + sizes[0] + sizes[1]
        if (offset + length != at + size).any():
            raise FormatError("a record of another length than its values")
        found = Rows(rowid, self._integers(body, topic), self._integers(body + sizes[0], timestamp), offset, length)
        drop_pages(self._view, low, high)
        return found

    def _varints(self, at: Array, end: Array, count: int) -> tuple[list[Array], list[Array]]:
        """`count` consecutive numbers (n,), and where each ends (n,)."""
        window = gather(self.data, at, _WINDOW)
        if not len(window):
            return [at] * count, [at] * count
        stops = np.flatnonzero(window[0] < 0x80)[:count] + 1
        if len(stops) < count or not _same_ends(window, int(stops[-1])):
            return self._one_by_one(at, end, count)
        if (at + stops[-1] > end).any() or max(np.diff(stops, prepend=0)) > _VARINT:
            raise FormatError("a number that goes past its page, or of nine bytes")
        values = []
        for start, stop in zip([0, *stops[:-1].tolist()], stops.tolist(), strict=True):
            value = window[:, stop - 1].astype(np.int64)
            for k in range(start, stop - 1):
                value |= (window[:, k] & 0x7F).astype(np.int64) << 7 * (stop - 1 - k)
            values.append(value)
        return values, [at + stop for stop in stops.tolist()]

    def _one_by_one(self, at: Array, end: Array, count: int) -> tuple[list[Array], list[Array]]:
        values, places = [], []
        for _ in range(count):
            value, at = self._varint(at, end)
            values.append(value)
            places.append(at)
        return values, places

    def _varint(self, at: Array, end: Array) -> tuple[Array, Array]:
        """Numbers (n,) of up to eight bytes, and where they end."""
        value, more = np.zeros(len(at), np.int64), np.ones(len(at), bool)
        for _ in range(_VARINT):
            if (at >= end).any():
                raise FormatError("a number that goes past its page")
            byte = self.data[at]
            value = np.where(more, (value << 7) | (byte & 0x7F), value)
            at = at + more
            more = more & (byte > 0x7F)
            if not more.any():
                return value, at
            end = np.where(more, end, np.maximum(end, at + 1))
        raise FormatError("a number of nine bytes")

    def _number(self, at: Array, size: int) -> Array:
        """Unsigned big-endian numbers (n,) of `size` bytes."""
        value: Array = np.zeros(len(at), np.int64)
        for k in range(size):
            value = (value << 8) | self.data[at + k]
        return value

    def _integers(self, at: Array, kind: Array) -> Array:
        """Integers (n,) of these serial types."""
        value: Array = (kind == _ONE).astype(np.int64)
        for one in np.flatnonzero(np.bincount(kind, minlength=_ZERO)[:_FLOAT]).tolist():
            rows, size = np.flatnonzero(kind == one), int(_SIZES[one])
            shift = 64 - 8 * size
            if size == _EIGHT:
                value[rows] = gather(self.data, at[rows], size).view(">i8")[:, 0]
            else:
                value[rows] = (self._number(at[rows], size) << shift) >> shift
        return value


def _same_ends(window: Array, width: int) -> bool:
    """Whether the numbers in the first `width` bytes of all rows (n,_WINDOW) end at the same bytes."""
    mask = np.zeros(_WINDOW, np.uint8)
    mask[:width] = 0x80
    rows, ends = window.view(np.uint64), mask.view(np.uint64)
    return not any(((rows[:, k] ^ rows[0, k]) & ends[k]).any() for k in range(-(-width // 8)))


def _checked(header: list[Array], found: Array) -> tuple[Array, Array, Array]:
    """The serial types of topic, time and payload; FormatError when the header, `found` bytes long, has others."""
    size, key, topic, timestamp, blob = header
    numbers = np.concatenate([topic, timestamp])
    odd = (key != 0).any() or (numbers < 1).any() or (numbers > _ONE).any() or (numbers == _FLOAT).any()
    if odd or (blob < _BLOB).any() or (blob % 2).any() or (size != found).any():
        raise FormatError("other columns than rosbag2's")
    return topic, timestamp, blob

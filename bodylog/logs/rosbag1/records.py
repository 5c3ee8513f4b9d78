"""Records of ROS 1 bags (format 2.0): headers of
name=value fields, and the next sound record after damage.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from ...errors import FormatError
from ..storage.mmapped import drop_pages, is_zero

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)

_U32 = struct.Struct("<I")
_NUMBERS = {1: struct.Struct("<B"), 4: _U32, 8: struct.Struct("<Q")}
_TIME = struct.Struct("<II")
_OP = b"\x04\x00\x00\x00op="
_LONGEST_HEADER = 1 << 16
_BACK = 256


@dataclass(frozen=True)
class BagRecord:
    """One record: op, header fields, its start, and start and length of its data."""

    op: int
    fields: dict[bytes, memoryview]
    start: int
    body: int
    size: int

    @property
    def end(self) -> int:
        """The byte after the record."""
        return self.body + self.size

    def number(self, name: bytes, width: int = 4) -> int:
        """An unsigned field of `width` bytes; FormatError if it is missing or of another width."""
        value = self.fields.get(name)
        if value is None or len(value) != width:
            raise FormatError(
                f"byte {self.start}: no {width}-byte field {name.decode()} in a record of op "
                f"{self.op}"
            )
        return int(_NUMBERS[width].unpack(value)[0])

    def time_ns(self, name: bytes) -> int:
        """A time field in ns since the epoch."""
        self.number(name, 8)
        seconds, nanoseconds = _TIME.unpack(self.fields[name])
        return int(seconds) * 10**9 + int(nanoseconds)


def fields_of(data: memoryview, start: int, end: int) -> dict[bytes, memoryview]:
    """name -> value of the header fields between two
    bytes; FormatError when they do not fill it exactly.
    """
    fields = {}
    at = start
    while at < end:
        size = _U32.unpack_from(data, at)[0] if end - at >= 4 else end
        if size > end - at - 4:
            raise FormatError(f"byte {at}: a header field passes the end of its header")
        name, equals, _ = bytes(data[at + 4 : at + 4 + min(size, 64)]).partition(b"=")
        if not equals:
            raise FormatError(f"byte {at}: a header field without a name")
        fields[name] = data[at + 5 + len(name) : at + 4 + size]
        at += 4 + size
    return fields


def record_at(data: memoryview, at: int, end: int) -> BagRecord:
    """The record at byte `at`; FormatError when there is no whole one before `end`."""
    size = _U32.unpack_from(data, at)[0] if end - at >= 8 else _LONGEST_HEADER
    if size >= _LONGEST_HEADER or size > end - at - 8:
        raise FormatError(f"byte {at}: no record header fits there")
    fields = fields_of(data, at + 4, at + 4 + size)
    body = at + 8 + size
    length = _U32.unpack_from(data, body - 4)[0]
    if length > end - body or len(fields.get(b"op", b"")) != 1:
        raise FormatError(f"byte {at}: a record of {length} bytes where {end - body} are left")
    return BagRecord(fields[b"op"][0], fields, at, body, length)


def iterate_bag_records(
    data: memoryview,
    start: int,
    end: int,
    lost: Callable[[int, int], None],
    cut: Callable[[int], int | None] = lambda _at: None,
) -> Iterator[BagRecord]:
    """The records between two bytes; after each damage
    `lost(start, size)` is called and the search resumes.

    If the file ends inside an unreadable record or empty
    chunk, `cut(start)` gives where the next records begin.
    """
    at = start
    while at < end:
        try:
            record = record_at(data, at, end)
        except FormatError:
            found = cut(at)
            if found is None:
                found = _find_next_bag_record(data, at + 1, end)
                lost(at, found - at)
            at = found
            continue
        inside = cut(at) if record.op == CHUNK and not record.size else None
        if inside is None:
            yield record
        at = record.end if inside is None else inside


def _find_next_bag_record(data: memoryview, start: int, end: int) -> int:
    """The first byte from `start` where a whole record begins, or `end`."""
    window = 1 << 20
    for low in range(start, end, window):
        if is_zero(data, low, min(end, low + window)):
            continue
        text = bytes(data[low : min(end, low + window + _BACK)])
        at = text.find(_OP)
        while at >= 0:
            found = _record_start(data, max(start, low + at - _BACK), low + at, end)
            if found is not None:
                return found
            at = text.find(_OP, at + 1)
        drop_pages(data, low, min(end, low + window))
    return end


def _record_start(data: memoryview, low: int, op: int, end: int) -> int | None:
    """The start of the whole record whose op field is at byte `op`, or None."""
    for at in range(op - 4, low - 1, -1):
        size = _U32.unpack_from(data, at)[0]
        if op + 8 - at - 4 <= size < _LONGEST_HEADER:
            try:
                if MESSAGE <= record_at(data, at, end).op <= CONNECTION:
                    return at
            except FormatError:
                continue
    return None

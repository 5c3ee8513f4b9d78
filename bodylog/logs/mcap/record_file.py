"""Read an MCAP's records outside chunks head by head, without loading the rest."""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from isal.isal_zlib import crc32

from ...errors import FormatError
from . import opcodes as op
from .records import HEAD, MAGIC, Record, iter_records, parse_record

_WINDOW = 4096
_FIRST = 6
_FOOTER = HEAD.size + 20 + len(MAGIC)


class Head(NamedTuple):
    """One record: opcode, start, length of its body, and the body's first six bytes."""

    opcode: int
    start: int
    size: int
    first: bytes

    @property
    def end(self) -> int:
        """Where the next record starts."""
        return self.start + HEAD.size + self.size


class RecordFile:
    """An open MCAP file, read record by record."""

    def __init__(self, path: Path) -> None:
        """Open the file; FormatError when it does not begin as an MCAP."""
        self._file = path.open("rb", buffering=0)
        self.size = os.fstat(self._file.fileno()).st_size
        if os.pread(self._file.fileno(), len(MAGIC), 0) != MAGIC:
            self._file.close()
            raise FormatError("the file does not begin as an MCAP")

    def __enter__(self) -> "RecordFile":
        """Return the file."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self._file.close()

    def read(self, start: int, size: int) -> bytes:
        """Read `size` bytes from `start`; FormatError when the file ends before."""
        found = os.pread(self._file.fileno(), size, start)
        if len(found) < size:
            raise FormatError(f"byte {start}: {len(found)} bytes where {size} belong")
        return found

    def prefetch(self, places: Iterable[tuple[int, int]]) -> None:
        """Request these (start, size) from the disk at once, to avoid waiting for each in turn."""
        for start, size in places if hasattr(os, "posix_fadvise") else ():
            if start + size <= self.size:
                os.posix_fadvise(self._file.fileno(), start, size, os.POSIX_FADV_WILLNEED)

    def record(self, head: Head) -> bytes:
        """Read a whole record."""
        return self.read(head.start, HEAD.size + head.size)

    def fields(self, head: Head) -> Record:
        """Read and parse a whole record."""
        return parse_record(head.opcode, memoryview(self.record(head))[HEAD.size :], head.start)

    def heads(self, end: int) -> Iterator[Head]:
        """The records from the magic to byte `end`; FormatError where one extends past it."""
        at = len(MAGIC)
        low = 0
        window = b""
        while at < end:
            if at - low + HEAD.size + _FIRST > len(window):
                low = at
                window = os.pread(self._file.fileno(), _WINDOW, at)
            if len(window) < HEAD.size:
                raise FormatError(f"byte {at}: the file ends inside a record's head")
            opcode, size = HEAD.unpack_from(window, at - low)
            if opcode == 0 or size > end - at - HEAD.size:
                raise FormatError(
                    f"byte {at}: opcode {opcode} with {size} bytes; {end - at - HEAD.size} are left"
                )
            body = at - low + HEAD.size
            yield Head(opcode, at, size, window[body : body + min(size, _FIRST)])
            at += HEAD.size + size

    def summary(self) -> tuple[int, list[tuple[Record, bytes]]]:
        """Where the summary starts, and its records,
        parsed and raw; FormatError when it is damaged.
        """
        foot = self.size - _FOOTER
        tail = self.read(max(foot, 0), min(_FOOTER, self.size))
        if foot < len(MAGIC) or tail[-len(MAGIC) :] != MAGIC or tail[0] != op.FOOTER:
            raise FormatError("the file does not end in a footer")
        fields = parse_record(op.FOOTER, memoryview(tail)[HEAD.size : -len(MAGIC)]).fields
        start = int(fields["summary_start"])
        if not len(MAGIC) <= start < foot:
            raise FormatError("there is no summary")
        raw = self.read(start, foot - start)
        if fields["summary_crc"] not in (0, crc32(raw + tail[: HEAD.size + 16])):
            raise FormatError("the summary's CRC fails")
        view = memoryview(raw)
        records = [
            (
                parse_record(op, view[at : at + size], start + at - HEAD.size),
                raw[at - HEAD.size : at + size],
            )
            for op, at, size in iter_records(view, 0, len(raw))
        ]
        return start, records

    def crc(self, end: int) -> int:
        """CRC-32 of the bytes before `end`."""
        found = 0
        for at in range(0, end, 1 << 20):
            found = crc32(self.read(at, min(1 << 20, end - at)), found)
        return found


def sound_heads(path: Path) -> Iterator[tuple[RecordFile, Head]]:
    """The records outside chunks up to the first damaged one; none when the file is not an MCAP."""
    try:
        with RecordFile(path) as file:
            for head in file.heads(file.size - len(MAGIC)):
                yield file, head
    except (FormatError, OSError):
        return

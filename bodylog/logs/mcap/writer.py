"""Write an MCAP: messages become chunks with indexes, then one summary of the whole file."""

import struct
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, BinaryIO

import numpy as np
from isal.isal_zlib import crc32

from . import encode as mcap
from . import opcodes as op
from .encode import MessageTable
from .records import HEAD, MAGIC

CHUNK_BYTES = 1 << 20
_LEVEL = 1
_WORTH = 0.95
_MOST = 0xFFFF
_AHEAD = 2
"""Chunks compressed while the previous one is written."""


@dataclass
class Contents:
    """Content of the summary: records by id or in file
    order, messages per channel, first and last log time.
    """

    schemas: dict[int, bytes] = field(default_factory=dict)
    channels: dict[int, bytes] = field(default_factory=dict)
    chunks: list[bytes] = field(default_factory=list)
    attachments: list[bytes] = field(default_factory=list)
    metadata: list[bytes] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    span: tuple[int, int] | None = None

    def seen(self, start_ns: int, end_ns: int) -> None:
        """Widen the span of log times."""
        first, last = self.span or (start_ns, end_ns)
        self.span = min(first, start_ns), max(last, end_ns)


@dataclass(frozen=True, eq=False)
class _Packed:
    """A chunk ready to write: times, size, packed bytes, record head, messages by channel."""

    span: tuple[int, int]
    size: int
    compression: str
    stored: bytes
    head: bytes
    length: int
    indexes: dict[int, tuple[int, bytes]]


class McapRecordWriter:
    """Appends records to a stream at `position`; crc is that
    of all bytes before, or None if the file keeps none.
    """

    def __init__(
        self, stream: BinaryIO, contents: Contents, position: int = 0, crc: int | None = None
    ) -> None:
        """Start at `position` of the stream, whose CRC so far is `crc`."""
        self.contents = contents
        self._stream = stream
        self._position = position
        self._crc = crc
        self._schema_ids = {record[11:]: number for number, record in contents.schemas.items()}
        self._waiting: list[tuple[int, int, int, int]] = []
        self._payloads: list[bytes] = []
        self._waiting_bytes = 0

    def begin(self, profile: str, library: str) -> None:
        """Write the magic and header of a new file."""
        self.put(MAGIC + mcap.encode_header(profile, library))

    def put(self, *parts: bytes | memoryview) -> None:
        """Write raw bytes."""
        for part in parts:
            self._stream.write(part)
            self._position += len(part)
            if self._crc is not None:
                self._crc = crc32(part, self._crc)

    def topic(
        self,
        name: str,
        kind: str,
        encoding: str,
        definition: bytes,
        definition_encoding: str,
        about: Mapping[str, str],
    ) -> int:
        """Declare a topic; returns its channel id. Equal definitions share one schema."""
        number = _lowest_free_id(self.contents.channels)
        schema_id = self._schema(kind, definition_encoding, definition) if kind or definition else 0
        self.contents.channels[number] = mcap.encode_channel(
            number, schema_id, name, encoding, about
        )
        self.contents.counts.setdefault(number, 0)
        self.put(self.contents.channels[number])
        return number

    def add_message(
        self, channel: int, sequence: int, log_ns: int, publish_ns: int, payload: bytes | memoryview
    ) -> None:
        """Keep one message until a chunk of about 1 MiB is full, or until more is written."""
        self._waiting.append((channel, sequence, log_ns, publish_ns))
        self._payloads.append(bytes(payload))  # a view's buffer may be filled again
        self._waiting_bytes += mcap.MESSAGE_HEAD + len(payload)
        if self._waiting_bytes >= CHUNK_BYTES:
            self._write_waiting()

    def _write_waiting(self) -> None:
        if not self._waiting:
            return
        channel, sequence, log_ns, publish_ns = np.array(self._waiting, np.uint64).T
        length = np.array([len(payload) for payload in self._payloads])
        data = (np.frombuffer(b"".join(self._payloads), np.uint8),)
        self._waiting = []
        self._payloads = []
        self._waiting_bytes = 0
        offset = np.cumsum(length) - length
        self.write(MessageTable(channel, sequence, log_ns, publish_ns, data, offset, length))

    def write(self, table: MessageTable) -> None:
        """Write messages in the given order, as chunks of about 1 MiB each."""
        self._write_waiting()
        edges = np.cumsum(table.length + mcap.MESSAGE_HEAD) // CHUNK_BYTES
        cuts = [0, *(np.flatnonzero(np.diff(edges)) + 1).tolist(), len(edges)]
        parts = (
            _table_rows(table, slice(first, last)) for first, last in pairwise(cuts) if last > first
        )
        with ThreadPoolExecutor(2) as pool:
            waiting: deque[Future[_Packed]] = deque()
            for part in parts:
                waiting.append(pool.submit(_compress_messages, part))
                if len(waiting) > _AHEAD:
                    self._chunk(waiting.popleft().result())
            while waiting:
                self._chunk(waiting.popleft().result())

    def about(self, name: str, pairs: Mapping[str, str]) -> None:
        """Write a metadata record."""
        self.keep_metadata(name, mcap.encode_metadata(name, pairs))

    def keep_metadata(self, name: str, record: bytes) -> None:
        """Write a metadata record of another file unchanged."""
        self.contents.metadata.append(mcap.metadata_index(self._position, len(record), name))
        self.put(record)

    def keep_attachment(self, record: bytes, fields: Mapping[str, Any]) -> None:
        """Write an attachment of another file, with these `fields`, unchanged."""
        self.contents.attachments.append(mcap.attachment_index(self._position, len(record), fields))
        self.put(record)

    def finish(self) -> None:
        """Write DataEnd, the summary, its offsets and the footer."""
        self._write_waiting()
        self.put(mcap.data_end(self._crc or 0))
        self._stream.write(_encode_summary(self.contents, self._position))

    def _schema(self, kind: str, encoding: str, definition: bytes) -> int:
        number = _lowest_free_id(self.contents.schemas)
        record = mcap.encode_schema(number, kind, encoding, definition)
        known = self._schema_ids.setdefault(record[11:], number)
        if known == number:
            self.contents.schemas[number] = record
            self.put(record)
        return known

    def _chunk(self, packed: _Packed) -> None:
        place = self._position, packed.length
        self.put(packed.head, packed.stored)
        indexes_at = self._position
        indexes = {}
        for number, (count, index) in packed.indexes.items():
            indexes[number] = self._position
            self.put(index)
            self.contents.counts[number] += count
        sizes = len(packed.stored), packed.size
        self.contents.chunks.append(
            mcap.chunk_index(
                packed.span, place, indexes, self._position - indexes_at, packed.compression, sizes
            )
        )
        self.contents.seen(*packed.span)


def _compress_messages(table: MessageTable) -> _Packed:
    import zstandard

    raw, start = mcap.encode_messages(table)
    span = int(table.log_ns.min()), int(table.log_ns.max())
    stored = zstandard.ZstdCompressor(_LEVEL).compress(raw.data)
    compression = "zstd"
    if len(stored) >= _WORTH * raw.size:
        stored = raw.tobytes()
        compression = ""
    head, length = mcap.encode_chunk_head(*span, raw.size, crc32(raw.data), compression, stored)
    indexes = {
        number: (len(rows), mcap.message_index(number, table.log_ns[rows], start[rows]))
        for number, rows in mcap.group_rows(table.channel)
    }
    return _Packed(span, raw.size, compression, stored, head, length, indexes)


def _lowest_free_id(taken: Mapping[int, bytes]) -> int:
    last = max(taken, default=0)
    return last + 1 if last < _MOST else next(n for n in range(1, _MOST + 1) if n not in taken)


def _table_rows(table: MessageTable, rows: slice) -> MessageTable:
    return MessageTable(
        table.channel[rows],
        table.sequence[rows],
        table.log_ns[rows],
        table.publish_ns[rows],
        table.data,
        table.offset[rows],
        table.length[rows],
    )


def _encode_summary(contents: Contents, start: int) -> bytes:
    groups = [
        (op.SCHEMA, [contents.schemas[number] for number in sorted(contents.schemas)]),
        (op.CHANNEL, [contents.channels[number] for number in sorted(contents.channels)]),
        (op.STATISTICS, [_summary_statistics(contents)]),
        (op.CHUNK_INDEX, contents.chunks),
        (op.ATTACHMENT_INDEX, contents.attachments),
        (op.METADATA_INDEX, contents.metadata),
    ]
    body = b""
    offsets = b""
    for opcode, records in groups:
        group = b"".join(records)
        if group:
            place = struct.pack("<BQQ", opcode, start + len(body), len(group))
            offsets += mcap.encode_record(op.SUMMARY_OFFSET, place)
            body += group
    foot = body + offsets + HEAD.pack(op.FOOTER, 20) + struct.pack("<QQ", start, start + len(body))
    return foot + struct.pack("<I", crc32(foot)) + MAGIC


def _summary_statistics(contents: Contents) -> bytes:
    numbers = (
        len(contents.schemas),
        len(contents.channels),
        len(contents.attachments),
        len(contents.metadata),
        len(contents.chunks),
    )
    return mcap.encode_statistics(contents.counts, numbers, contents.span or (0, 0))

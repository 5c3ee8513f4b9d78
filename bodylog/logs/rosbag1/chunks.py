"""Chunks of a ROS 1 bag: decompress them, find their messages by index or record by record."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...errors import FormatError
from ..diagnostics import Diagnostics
from ..records import Array
from ..storage.compression import Buffer
from .records import CHUNK, INDEX, MESSAGE, BagRecord, fields_of, iterate_bag_records, record_at
from .truncated import cut_at, decompress_truncated

_VARY = ((b"conn=", 4), (b"time=", 8))


class Index(NamedTuple):
    """One connection's message list in a chunk: byte of the list, number of entries."""

    at: int
    entries: int


@dataclass(frozen=True)
class BagChunk:
    """One chunk: byte of its record, and {connection: messages in it}, empty when unknown.

    `cut`: the file ends in it; it is read as far as it decompresses.
    """

    start: int
    counts: dict[int, int]
    cut: bool = False


class BagRun(NamedTuple):
    """A run of message records outside chunks."""

    start: int
    end: int


class BagMessages(NamedTuple):
    """Messages inside a chunk, in order: connection,
    log time (ns), and where each payload is; all (n,).
    """

    connection: Array
    log_ns: Array
    offset: Array
    length: Array
    starts: Array


def load_bag_chunk(
    data: memoryview, chunk: BagChunk, buffer: Buffer, diagnostics: Diagnostics
) -> tuple[Array, dict[int, Index]] | None:
    """The chunk's records (bytes,) uint8 and the message
    lists after it; None and a loss when it is damaged.
    """
    if chunk.cut:
        found = cut_at(data, chunk.start)
        return (np.frombuffer(decompress_truncated(found), np.uint8), {}) if found else None
    size = None
    try:
        record = record_at(data, chunk.start, len(data))
        size = record.end - chunk.start
        if record.op != CHUNK:
            raise FormatError(f"byte {chunk.start}: op {record.op} where a chunk was announced")
        compression = str(record.fields.get(b"compression", b""), "ascii", "replace")
        packed = data[record.body : record.end]
        return buffer.load(compression, packed, record.number(b"size")), indexes_at(
            data, record.end
        )
    except FormatError as problem:
        diagnostics.add_loss(
            chunk.start, size, sum(chunk.counts.values()) or None, None, str(problem)
        )
        return None


def indexes_at(data: memoryview, at: int) -> dict[int, Index]:
    """{connection: its list of messages} from the index records at byte `at`."""
    indexes: dict[int, Index] = {}
    while at < len(data):
        try:
            record = record_at(data, at, len(data))
            if record.op != INDEX or record.number(b"count") * 12 > record.size:
                return indexes
            indexes[record.number(b"conn")] = Index(record.body, record.number(b"count"))
        except FormatError:
            return indexes
        at = record.end
    return indexes


def list_bag_messages(
    content: Array,
    data: memoryview,
    place: int,
    indexes: dict[int, Index],
    diagnostics: Diagnostics,
) -> BagMessages:
    """All messages of a loaded chunk in order: by its
    indexes if they are right, else record by record.
    """
    found = _list_indexed_bag_messages(content, data, indexes) if indexes else None
    if found is None:
        if indexes:
            diagnostics.warn(
                f"the index of the chunk at byte {place} is wrong; its records were read one by one"
            )
        return scan_messages(content.data, 0, len(content), place, diagnostics)
    return found


def _sliding_windows(content: Array, width: int) -> Array:
    """A view (n, width) whose row i holds the bytes from byte i."""
    rows = max(0, len(content) - width + 1)
    return np.ndarray((rows, width), np.uint8, content, 0, (1, 1))


def _read_u32(content: Array, at: Array) -> Array:
    return _sliding_windows(content, 4)[at].view("<u4")[:, 0].astype(np.int64)


def _list_indexed_bag_messages(
    content: Array, data: memoryview, indexes: dict[int, Index]
) -> BagMessages | None:
    lists = [
        np.frombuffer(data, "<u4", 3 * count, at)[2::3].astype(np.int64)
        for at, count in indexes.values()
    ]
    starts = np.concatenate(lists)
    listed = np.repeat(np.array(list(indexes), np.int64), [len(part) for part in lists])
    if not len(starts) or starts.max() > len(content) - 8:
        return None
    order = np.argsort(starts, kind="stable")
    starts = starts[order]
    listed = listed[order]
    header = _read_u32(content, starts)
    offset = starts + 8 + header
    if offset.max() > len(content):
        return None
    length = _read_u32(content, offset - 4)
    if not _records_fill_gaps(content, starts, offset + length):
        return None
    connection = np.empty_like(starts)
    log_ns = np.empty_like(starts)
    for size in np.unique(header).tolist():
        rows = np.flatnonzero(header == size)
        same = _same_headers(content, starts[rows] + 4, size)
        if same is None:
            return None
        connection[rows], log_ns[rows] = same
    return (
        BagMessages(connection, log_ns, offset, length, starts)
        if (connection == listed).all()
        else None
    )


def _same_headers(content: Array, at: Array, size: int) -> tuple[Array, Array] | None:
    """Connection and time of message headers that differ in nothing else; None if they differ."""
    headers = _sliding_windows(content, size)[at]
    first = memoryview(headers[0].data)
    try:
        record = BagRecord(MESSAGE, fields_of(first, 0, size), 0, 0, 0)
        record.number(b"conn"), record.number(b"time", 8)
    except FormatError:
        return None
    if bytes(record.fields.get(b"op", b"")) != bytes([MESSAGE]):
        return None
    text = bytes(first)
    conn, time = (
        text.index(bytes([len(name) + width, 0, 0, 0]) + name) + 4 + len(name)
        for name, width in _VARY
    )
    same = np.ones(size, bool)
    same[conn : conn + 4] = False
    same[time : time + 8] = False
    if (headers[:, same] != headers[0, same]).any():
        return None
    seconds = np.ascontiguousarray(headers[:, time : time + 8]).view("<u4").astype(np.int64)
    connection = (
        np.ascontiguousarray(headers[:, conn : conn + 4]).view("<u4")[:, 0].astype(np.int64)
    )
    return connection, seconds[:, 0] * 10**9 + seconds[:, 1]


def _records_fill_gaps(content: Array, starts: Array, ends: Array) -> bool:
    """Whether only whole other records lie between the messages, so that the index misses none."""
    lows = np.concatenate(([0], ends))
    highs = np.concatenate((starts, [len(content)]))
    if (lows > highs).any():
        return False
    view = content.data
    try:
        for i in np.flatnonzero(lows < highs):
            at = int(lows[i])
            end = int(highs[i])
            while at < end:
                record = record_at(view, at, end)
                if record.op == MESSAGE:
                    return False
                at = record.end
    except FormatError:
        return False
    return True


def scan_messages(
    data: memoryview, start: int, end: int, place: int, diagnostics: Diagnostics
) -> BagMessages:
    """The messages between two bytes of `data`, record
    by record; losses are reported at byte `place`.
    """

    def lost(at: int, size: int) -> None:
        diagnostics.add_loss(
            place, size, None, None, f"records inside the chunk are damaged from its byte {at}"
        )

    rows = []
    for record in iterate_bag_records(data, start, end, lost):
        if record.op == MESSAGE:
            try:
                row = (
                    record.number(b"conn"),
                    record.time_ns(b"time"),
                    record.body,
                    record.size,
                    record.start,
                )
            except FormatError:
                lost(record.start, record.end - record.start)
                continue
            rows.append(row)
    return BagMessages(*np.array(rows, np.int64).reshape(-1, 5).T)

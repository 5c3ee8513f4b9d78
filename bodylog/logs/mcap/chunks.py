"""Chunks of an MCAP: decompress them, check their
CRC, find their messages by index or record by record.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from isal.isal_zlib import crc32

from ...errors import FormatError
from ..diagnostics import Diagnostics
from ..records import Array
from ..storage.compression import Buffer
from ..storage.mmapped import ensure_local
from . import opcodes as op
from .records import HEAD, iter_records

MESSAGE_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("size", "<i8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log", "<i8"),
        ("publish", "<i8"),
    ]
)
"""The first 31 bytes of a Message record; the payload follows."""

_BLOCK = 4096
_BLOCK_BYTES = 4 << 20
_FEW = 16
_SHORTEST = MESSAGE_HEAD.itemsize
_HEAD = np.dtype([("opcode", "u1"), ("size", "<u8")])
CHUNK_HEAD = struct.Struct("<QQQII")
_U64 = struct.Struct("<Q")
_INDEX_HEAD = struct.Struct("<BQHI")


class Chunk(NamedTuple):
    """One Chunk record: where it is, its log times (ns),
    and {channel: position of its MessageIndex}, if known.

    `listed`: a sound summary lists it; otherwise an index may be missing, and every request opens
    the chunk. `stored`: it is declared uncompressed. `cut`: the file ends inside it.
    """

    start: int
    length: int
    start_ns: int
    end_ns: int
    indexes: Mapping[int, int] = MappingProxyType({})
    listed: bool = False
    stored: bool = False
    cut: bool = False


class LooseRecords(NamedTuple):
    """A run of sound records outside chunks, with messages among them."""

    start: int
    end: int


class MessageRecords(NamedTuple):
    """Message records inside `data`: where each starts
    (n,) and its first 31 bytes (n,) MESSAGE_HEAD.
    """

    starts: Array
    heads: Array


def chunk_head(
    data: memoryview, start: int, cut: bool = False
) -> tuple[int, int, int, int, str, memoryview]:
    """Start, end (ns), unpacked size, CRC, compression and
    packed bytes of the Chunk at `start`; or FormatError.

    `cut`: the file ends inside the chunk; return the packed bytes before the end.
    """
    if start < 0 or len(data) - start < HEAD.size + CHUNK_HEAD.size:
        raise FormatError(f"byte {start}: too few bytes for a chunk")
    opcode, length = HEAD.unpack_from(data, start)
    first, last, size, crc, letters = CHUNK_HEAD.unpack_from(data, start + HEAD.size)
    at = start + HEAD.size + CHUNK_HEAD.size + letters
    beyond = length > len(data) - start - HEAD.size
    if opcode != op.CHUNK or beyond != cut or letters > 16 or at + 8 > len(data):
        raise FormatError(f"byte {start}: opcode {opcode} with {length} bytes is not a whole chunk")
    packed = _U64.unpack_from(data, at)[0]
    if at + 8 + packed > start + HEAD.size + length:
        raise FormatError(
            f"byte {start}: a chunk of {length} bytes claims {packed} bytes of records"
        )
    compression = str(data[at - letters : at], "ascii", "replace")
    return first, last, size, crc, compression, data[at + 8 : at + 8 + packed]


def records_at(chunk: Chunk, compression: str) -> int:
    """The offset in the file at which a chunk's packed records begin."""
    return chunk.start + HEAD.size + CHUNK_HEAD.size + len(compression) + _U64.size


def unpack_chunk(data: memoryview, chunk: Chunk, buffer: Buffer) -> Array:
    """The chunk's records (bytes,) uint8; FormatError when decompression or the CRC check fails.

    A truncated chunk gives the records before the cut, without a CRC check.
    """
    ensure_local(data, chunk.start, chunk.start + chunk.length)
    _, _, size, crc, compression, packed = chunk_head(data, chunk.start, chunk.cut)
    content = buffer.load(compression, packed, size, chunk.cut)
    if chunk.cut and len(content) < size:
        return content
    found = crc32(content.data) if crc else 0
    if found != crc:
        raise FormatError(f"the chunk's CRC is {found:08x} where {crc:08x} is declared")
    return content


def load_chunk(
    data: memoryview, chunk: Chunk, buffer: Buffer, diagnostics: Diagnostics
) -> Array | None:
    """The chunk's records (bytes,) uint8 if its CRC
    matches, else None and a loss in the diagnostics.
    """
    try:
        return unpack_chunk(data, chunk, buffer)
    except FormatError as problem:
        record_loss(data, chunk, problem, diagnostics)
        return None


def record_loss(
    data: memoryview, chunk: Chunk, problem: FormatError, diagnostics: Diagnostics
) -> None:
    """Record the loss of a chunk."""
    count = sum(len(index_of(data, at)) for at in chunk.indexes.values()) if chunk.indexes else None
    seconds = max(0, chunk.end_ns - chunk.start_ns) / 1e9
    diagnostics.add_loss(chunk.start, chunk.length, count, seconds, str(problem))


def index_of(data: memoryview, at: int) -> Array:
    """The MessageIndex at byte `at`: (n, 2) int64 log time
    (ns) and offset in the chunk; empty if it is not one.
    """
    if not 0 <= at <= len(data) - _INDEX_HEAD.size:
        return np.empty((0, 2), np.int64)
    ensure_local(data, at, at + _INDEX_HEAD.size)
    opcode, length, _, size = _INDEX_HEAD.unpack_from(data, at)
    if opcode != op.MESSAGE_INDEX or size > length or at + _INDEX_HEAD.size + size > len(data):
        return np.empty((0, 2), np.int64)
    ensure_local(data, at, at + _INDEX_HEAD.size + size)
    return np.frombuffer(data, "<i8", size // 16 * 2, at + _INDEX_HEAD.size).reshape(-1, 2)


def list_chunk_messages(
    content: Array, data: memoryview, chunk: Chunk, diagnostics: Diagnostics
) -> MessageRecords:
    """All messages of a loaded chunk in order: by its
    indexes if they are right, else record by record.
    """
    if chunk.indexes:
        found = list_indexed_messages(content, [(0, len(content))], data, [chunk])
        if found is not None:
            return found
        diagnostics.warn(
            f"the message indexes of the chunk at byte {chunk.start} are wrong; its records "
            "were read one by one"
        )
    return _scan_messages(content, chunk, diagnostics)


def heads_of(content: Array | memoryview) -> Array:
    """A view whose item i is the message head that starts at byte i."""
    return np.ndarray(
        (max(0, len(content) - MESSAGE_HEAD.itemsize + 1),), MESSAGE_HEAD, content, 0, (1,)
    )


def heads_at(content: Array | memoryview, starts: Array) -> Array:
    """The message heads (n,) that start at these bytes; gathering bytes is 20 times faster."""
    return heads_of(content).view(f"V{MESSAGE_HEAD.itemsize}")[starts].view(MESSAGE_HEAD)


def list_indexed_messages(
    content: Array, places: Sequence[tuple[int, int]], data: memoryview, chunks: Sequence[Chunk]
) -> MessageRecords | None:
    """All messages of chunks by their indexes, each chunk's
    records between two bytes of `content`; None if wrong.
    """
    listed = [
        (channel, index_of(data, at)[:, 1] + low)
        for (low, _), chunk in zip(places, chunks, strict=True)
        for channel, at in chunk.indexes.items()
    ]
    starts = np.concatenate([offsets for _, offsets in listed])
    if (
        not len(starts)
        or starts.min() < places[0][0]
        or starts.max() > places[-1][1] - MESSAGE_HEAD.itemsize
    ):
        return None
    heads = heads_at(content, starts)
    channels = np.repeat(
        [channel for channel, _ in listed], [len(offsets) for _, offsets in listed]
    )
    if (heads["opcode"] != op.MESSAGE).any() or (heads["channel"] != channels).any():
        return None
    if (starts[1:] <= starts[:-1]).any():
        order = np.argsort(starts, kind="stable")
        starts = starts[order]
        heads = heads[order]
    empty = (
        np.diff(np.searchsorted(starts, [low for low, _ in places]), append=len(starts)) == 0
    ).any()
    return (
        None
        if empty or not _records_fill_places(content, np.array(places), starts, heads["size"])
        else MessageRecords(starts, heads)
    )


def _records_fill_places(content: Array, places: Array, starts: Array, sizes: Array) -> bool:
    """Whether whole records without a gap fill each place, so that the index misses no message."""
    if sizes.min() < MESSAGE_HEAD.itemsize - HEAD.size or sizes.max() > len(content):
        return False
    # In order, what follows an edge is its place's end or a message: no message overlaps another or
    # an edge. Both are two runs in order, which a stable sort merges.
    lows = np.sort(np.concatenate((places[:, 0], starts + sizes + HEAD.size)), kind="stable")
    highs = np.sort(np.concatenate((starts, places[:, 1])), kind="stable")
    if (lows > highs).any():
        return False
    view = content.data
    try:
        between = [
            iter_records(view, lows[i].item(), highs[i].item())
            for i in np.flatnonzero(lows < highs)
        ]
        return all(opcode != op.MESSAGE for records in between for opcode, _, _ in records)
    except FormatError:
        return False


def _scan_messages(content: Array, chunk: Chunk, diagnostics: Diagnostics) -> MessageRecords:
    starts = []
    try:
        for opcode, body, length in iter_records(content.data, 0, len(content)):
            if opcode == op.MESSAGE and length >= MESSAGE_HEAD.itemsize - HEAD.size:
                starts.append(body - HEAD.size)
    except FormatError as problem:
        diagnostics.add_loss(chunk.start, chunk.length, None, None, f"inside the chunk, {problem}")
    return _message_records_at(content, starts)


def _message_records_at(content: Array | memoryview, starts: list[int]) -> MessageRecords:
    where = np.array(starts, np.int64)
    return MessageRecords(where, heads_at(content, where))


def loose_messages(data: memoryview, run: LooseRecords) -> Iterator[MessageRecords]:
    """The messages of a run, in blocks."""
    at = run.start
    while at < run.end:
        starts, after = follow_messages(data, at, run.end)
        if len(starts):
            yield MessageRecords(starts, heads_at(data, starts))
        else:
            after = at + HEAD.size + HEAD.unpack_from(data, at)[1]
        at = after


def follow_messages(data: memoryview, at: int, end: int) -> tuple[Array, int]:
    """Where consecutive Messages (n,) start from byte
    `at` to `end`, at most one block; and where they end.
    """
    if end - at < _SHORTEST:
        return np.empty(0, np.int64), at
    opcode, length = HEAD.unpack_from(data, at)
    step = HEAD.size + length
    if opcode != op.MESSAGE or not _SHORTEST <= step <= end - at:
        return np.empty(0, np.int64), at
    # Consecutive messages often have equal length: the
    # guess is cheap, and saves the loop where it holds.
    most = min(_BLOCK, (end - at) // step, max(1, _BLOCK_BYTES // step))
    heads = np.ndarray((most,), _HEAD, data, at, (step,))
    equal = (heads["opcode"] == op.MESSAGE) & (heads["size"] == length)
    count = most if equal.all() else int(equal.argmin())
    if count >= _FEW:
        return at + step * np.arange(count), at + step * count
    return _one_after_another(data, at, end)


def _one_after_another(data: memoryview, at: int, end: int) -> tuple[Array, int]:
    starts: list[int] = []
    unpack = HEAD.unpack_from
    last = end - HEAD.size
    stop = at + _BLOCK_BYTES
    for _ in range(_BLOCK):
        if at > last or at > stop:
            break
        opcode, length = unpack(data, at)
        if opcode != op.MESSAGE:
            break
        starts.append(at)
        at += HEAD.size + length
    if at > end:
        at = starts.pop()
    found = np.array(starts, np.int64)
    short = np.flatnonzero(np.diff(found, append=at) < _SHORTEST)
    return (found[: short[0]], int(found[short[0]])) if len(short) else (found, at)

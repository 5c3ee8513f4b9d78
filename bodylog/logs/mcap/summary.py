"""Read an MCAP's summary section; use it only where it agrees with itself and with the file."""

import struct
from collections.abc import Iterator
from typing import NamedTuple

from isal.isal_zlib import crc32

from ...errors import FormatError
from ..diagnostics import Diagnostics
from ..storage.compression import STORED
from ..storage.mmapped import advise_sequential, ensure_local
from . import opcodes as op
from .chunks import Chunk
from .records import FIELDS, HEAD, MAGIC, Record, iter_records, parse_record
from .survey import McapSurvey

_FOOTER = HEAD.size + 20
_INDEX_HEAD = struct.Struct("<QQQQI")
_INDEX_TAIL = struct.Struct("<QI")
_OFFSET = struct.Struct("<HQ")
_INDEX_SIZES = 16
_STORED = tuple(name.encode() for name in STORED)


class Summary(NamedTuple):
    """Start, records except chunk indexes, each chunk with
    the end of its indexes, number of indexed messages.

    Chunk indexes are not kept, as a long log has very many.
    """

    start: int
    records: list[Record]
    chunks: list[tuple[Chunk, int]]
    indexed: int


def footer_of(data: memoryview) -> Record | None:
    """The Footer that ends the file, or None."""
    start = len(data) - len(MAGIC) - _FOOTER
    if (
        start < len(MAGIC)
        or data[-len(MAGIC) :] != MAGIC
        or HEAD.unpack_from(data, start) != (op.FOOTER, 20)
    ):
        return None
    return parse_record(op.FOOTER, data[start + HEAD.size : start + _FOOTER], start)


def find_summary_section(data: memoryview) -> tuple[int, int] | None:
    """Start and end of the summary section; None without one, FormatError when its CRC fails."""
    footer = footer_of(data)
    if footer is None or not footer.fields["summary_start"]:
        return None
    start = footer.fields["summary_start"]
    crc = footer.fields["summary_crc"]
    if not len(MAGIC) <= start <= footer.start:
        raise FormatError(f"it is declared to start at byte {start}, outside the file")
    advise_sequential(data, start, len(data), alone=True)
    found = crc32(data[start : footer.start + HEAD.size + 16])
    if crc and found != crc:
        raise FormatError(f"its CRC is {found:08x} where {crc:08x} is declared")
    return start, footer.start


def records_of(data: memoryview, start: int, end: int) -> Iterator[Record]:
    """The summary section's records; FormatError where it is damaged."""
    for opcode, at, size in iter_records(data, start, end):
        if opcode in FIELDS:
            yield parse_record(opcode, data[at : at + size], at - HEAD.size)


def summary_of(data: memoryview) -> Summary | None:
    """Parse the summary; None without one, FormatError
    when it is damaged or lists chunks that do not exist.
    """
    place = find_summary_section(data)
    summary = _read_summary_records(data, *place) if place else None
    if summary is None or not (summary.records or summary.chunks):
        return None
    _require_chunks_fit(data, summary)
    return summary


def _read_summary_records(data: memoryview, start: int, end: int) -> Summary:
    records = []
    chunks = []
    indexed = 0
    for opcode, at, size in iter_records(data, start, end):
        if opcode == op.CHUNK_INDEX:
            chunk, after = _read_chunk_index(data, at, at + size)
            chunks.append((chunk, chunk.start + chunk.length + after))
            # Computed from their declared length: 15 bytes each and 16 per message.
            indexed += (after - 15 * len(chunk.indexes)) // 16
        elif opcode in FIELDS:
            records.append(parse_record(opcode, data[at : at + size], at - HEAD.size))
    return Summary(start, records, sorted(chunks, key=lambda pair: pair[0].start), indexed)


def _require_chunks_fit(data: memoryview, summary: Summary) -> None:
    """FormatError when a chunk is not where the summary places it, or two overlap."""
    starts = [*(chunk.start for chunk, _ in summary.chunks[1:]), summary.start]
    for (chunk, end), following in zip(summary.chunks, starts, strict=False):
        if chunk.start < len(MAGIC) or end > following:
            raise FormatError(
                f"a chunk of {chunk.length} bytes at byte {chunk.start} does not fit there"
            )
        if end == following:
            continue
        ensure_local(data, chunk.start, chunk.start + HEAD.size)
        if HEAD.unpack_from(data, chunk.start) != (op.CHUNK, chunk.length - HEAD.size):
            raise FormatError(f"there is no chunk of {chunk.length} bytes at byte {chunk.start}")


def _read_chunk_index(data: memoryview, at: int, end: int) -> tuple[Chunk, int]:
    """The chunk that the ChunkIndex between two bytes
    describes, and the length of its message indexes.

    Equivalent to `records.parse_record`, but faster: a long log
    has so many that they determine how long it takes to open.
    """
    if (left := end - at - _INDEX_HEAD.size - _INDEX_TAIL.size) < 0:
        raise FormatError(f"byte {at}: a chunk index of {end - at} bytes")
    first, last, start, length, table = _INDEX_HEAD.unpack_from(data, at)
    if table % _OFFSET.size or table > left:
        raise FormatError(f"byte {at}: a chunk index whose table takes {table} bytes")
    at += _INDEX_HEAD.size
    after, letters = _INDEX_TAIL.unpack_from(data, at + table)
    name = at + table + _INDEX_TAIL.size
    if letters + _INDEX_SIZES > end - name:
        raise FormatError(f"byte {at}: a chunk index with a name of {letters} bytes")
    stored = data[name : name + letters] in _STORED
    return Chunk(
        start, length, first, last, dict(_OFFSET.iter_unpack(data[at : at + table])), True, stored
    ), after


def use_statistics(summary: Summary, survey: McapSurvey, diagnostics: Diagnostics) -> bool:
    """Take counts and times from Statistics if they
    agree with indexes and channels; else change nothing.
    """
    statistics = next(
        (record.fields for record in summary.records if record.opcode == op.STATISTICS), None
    )
    if statistics is None:
        return False
    counts = statistics["channel_message_counts"]
    chunks = [part for part in survey.parts if isinstance(part, Chunk)]
    if sum(counts.values()) != statistics["message_count"]:
        diagnostics.warn(
            f"the statistics count {statistics['message_count']} messages, "
            f"{sum(counts.values())} by channel"
        )
        return False
    if len(summary.chunks) != len(chunks):
        return False
    if not survey.knows(counts.keys() | survey.counts.keys()):
        return False
    if any(chunk.indexes for chunk in chunks):
        indexed = summary.indexed + sum(survey.counts.values())
        if indexed != statistics["message_count"]:
            diagnostics.warn(
                f"the statistics count {statistics['message_count']} messages, the indexes "
                f"{indexed}"
            )
            survey.parts = [
                p._replace(indexes={}) if isinstance(p, Chunk) else p for p in survey.parts
            ]
            return False
    survey.counts = dict(counts)
    survey.times = (
        [statistics["message_start_time"], statistics["message_end_time"]]
        if statistics["message_count"]
        else []
    )
    timed = [chunk for chunk in chunks if chunk.end_ns]
    if timed:  # rosbag2's statistics ignore a message at time zero, its chunks do not
        survey.times += [
            min(chunk.start_ns for chunk in timed),
            max(chunk.end_ns for chunk in timed),
        ]
    return True

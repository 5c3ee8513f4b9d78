"""What an MCAP's summary section says, believed only where it agrees with itself and with the file."""

import zlib
from dataclasses import replace
from typing import Any

from ..errors import FormatError
from .chunks import Chunk
from .ledger import Ledger
from .mcap import Survey
from .records import CHUNK, CHUNK_INDEX, FIELDS, FOOTER, HEAD, MAGIC, STATISTICS, Record, parse, walk

_FOOTER = HEAD.size + 20


def footer_of(data: memoryview) -> Record | None:
    """The Footer that ends the file, or None."""
    start = len(data) - len(MAGIC) - _FOOTER
    if start < len(MAGIC) or data[-len(MAGIC) :] != MAGIC or HEAD.unpack_from(data, start) != (FOOTER, 20):
        return None
    return parse(FOOTER, data[start + HEAD.size : start + _FOOTER], start)


def summary_of(data: memoryview) -> list[Record] | None:
    """The summary section's records; None when there is none, FormatError when it is damaged."""
    footer = footer_of(data)
    if footer is None or not footer.fields["summary_start"]:
        return None
    start, crc = footer.fields["summary_start"], footer.fields["summary_crc"]
    if not len(MAGIC) <= start <= footer.start:
        raise FormatError(f"it is said to start at byte {start}, outside the file")
    found = zlib.crc32(data[start : footer.start + HEAD.size + 16])
    if crc and found != crc:
        raise FormatError(f"its CRC is {found:08x} where {crc:08x} is declared")
    listed = walk(data, start, footer.start)
    return [parse(opcode, data[at : at + size], at - HEAD.size) for opcode, at, size in listed if opcode in FIELDS]


def chunks_of(data: memoryview, records: list[Record]) -> list[tuple[Chunk, int]]:
    """The chunks the summary lists, in file order, each with where its indexes end, or FormatError."""
    listed = sorted((record.fields for record in records if record.opcode == CHUNK_INDEX), key=_place)
    chunks = [_chunk(said) for said in listed]
    sizes = (said["message_index_length"] for said in listed)
    ends = [chunk.start + chunk.length + size for chunk, size in zip(chunks, sizes, strict=True)]
    starts = [*(chunk.start for chunk in chunks[1:]), records[0].start]
    for chunk, end, following in zip(chunks, ends, starts, strict=False):
        if chunk.start < len(MAGIC) or end > following:
            raise FormatError(f"a chunk of {chunk.length} bytes at byte {chunk.start} does not fit there")
        if end != following and HEAD.unpack_from(data, chunk.start) != (CHUNK, chunk.length - HEAD.size):
            raise FormatError(f"there is no chunk of {chunk.length} bytes at byte {chunk.start}")
    return list(zip(chunks, ends, strict=True))


def _place(said: dict[str, Any]) -> int:
    return int(said["chunk_start_offset"])


def _chunk(said: dict[str, Any]) -> Chunk:
    return Chunk(
        said["chunk_start_offset"],
        said["chunk_length"],
        said["message_start_time"],
        said["message_end_time"],
        said["message_index_offsets"],
        listed=True,
    )


def believe_counts(records: list[Record], survey: Survey, ledger: Ledger) -> bool:
    """Take counts and times from Statistics where they agree with the indexes and the channels; else change nothing."""
    said = next((record.fields for record in records if record.opcode == STATISTICS), None)
    if said is None:
        return False
    counts = said["channel_message_counts"]
    chunks = [part for part in survey.parts if isinstance(part, Chunk)]
    listed = sum(record.opcode == CHUNK_INDEX for record in records)
    if sum(counts.values()) != said["message_count"]:
        ledger.warn(f"the statistics count {said['message_count']} messages, {sum(counts.values())} by channel")
        return False
    if listed != len(chunks):
        return False
    if not survey.knows(counts.keys() | survey.counts.keys()):
        return False
    if any(chunk.indexes for chunk in chunks):
        indexed = _indexed_messages(records)
        loose = sum(survey.counts.values())
        if indexed + loose != said["message_count"]:
            ledger.warn(f"the statistics count {said['message_count']} messages, the indexes {indexed + loose}")
            survey.parts = [replace(p, indexes={}) if isinstance(p, Chunk) else p for p in survey.parts]
            return False
    survey.counts = dict(counts)
    survey.times = [said["message_start_time"], said["message_end_time"]] if said["message_count"] else []
    for chunk in chunks:  # rosbag2 takes a message at time zero for none in its statistics, not in its chunks
        survey.times += [chunk.start_ns, chunk.end_ns] if chunk.end_ns else []
    return True


def _indexed_messages(records: list[Record]) -> int:
    """Messages in the indexes by arithmetic on their declared length: 15 bytes each and 16 per message."""
    listed = [record.fields for record in records if record.opcode == CHUNK_INDEX]
    return sum((said["message_index_length"] - 15 * len(said["message_index_offsets"])) // 16 for said in listed)

"""Which bytes of an MCAP can stay as they are, so that more chunks and a new summary can follow them."""

import mmap
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import FormatError
from .records import (
    ATTACHMENT,
    ATTACHMENT_INDEX,
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    HEAD,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    METADATA_INDEX,
    SCHEMA,
    STATISTICS,
    Record,
    parse,
    walk,
)
from .write import Contents

ROOT = "/bodylog/"
"""What we add to a log is under this topic."""

NAME = "bodylog"
"""The metadata record that says how it was made."""

_FOOTER = HEAD.size + 20 + len(MAGIC)
_DATA_END = HEAD.size + 4


@dataclass(frozen=True)
class Base:
    """Bytes [0, end) of a file, what its summary says of them, and their CRC where the file keeps one."""

    end: int
    crc: int | None
    contents: Contents


@dataclass(frozen=True)
class _Part:
    """One record of the data section; `channels` are those it speaks of, None when it is no channel's."""

    opcode: int
    start: int
    channels: frozenset[int] | None = None
    messages: int = 0


def is_mcap(path: Path) -> bool:
    """Whether a file begins as an MCAP does."""
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        return stream.read(len(MAGIC)) == MAGIC


def keepable(path: Path) -> Base:
    """All of a chunked MCAP with a sound summary but what an earlier run appended.

    FormatError says why the file must be rewritten instead: not chunked, no summary, one that its data contradict, or
    /bodylog/ messages between others.
    """
    return _open(path, ROOT)


def messages(path: Path) -> int:
    """How many messages the message indexes of an MCAP hold; FormatError where summary and data disagree."""
    return sum(_open(path, None).contents.counts.values())


def _open(path: Path, root: str | None) -> Base:
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
        data = memoryview(mapped)
        try:
            return _keepable(data, root)
        finally:
            data.release()


def _keepable(data: memoryview, root: str | None) -> Base:
    start = _summary_start(data)
    records = [
        parse(op, data[at : at + size], at - HEAD.size) for op, at, size in walk(data, start, len(data) - _FOOTER)
    ]
    summary = {op: [r for r in records if r.opcode == op] for op in {r.opcode for r in records}}
    raw = {r.start: bytes(data[r.start : r.start + _length(data, r.start)]) for r in records}
    parts = _parts(data, start, summary)
    ours = _ours(summary, root)
    foreign = {r.fields["offset"] for r in summary.get(METADATA_INDEX, []) if r.fields["name"] != NAME}
    cut = _cut(parts, ours, foreign)
    crc = _crc(data, cut, parts[-1].start)
    return Base(cut, crc, _contents(summary, raw, [p for p in parts if p.start < cut], ours))


def _summary_start(data: memoryview) -> int:
    """Where the summary begins; FormatError when there is none or its CRC fails."""
    foot = len(data) - _FOOTER
    if foot < len(MAGIC) or data[: len(MAGIC)] != MAGIC or data[-len(MAGIC) :] != MAGIC or data[foot] != FOOTER:
        raise FormatError("the file does not end in a footer")
    footer = parse(FOOTER, data[foot + HEAD.size : -len(MAGIC)]).fields
    start = int(footer["summary_start"])
    if not len(MAGIC) + _DATA_END <= start < foot:
        raise FormatError("there is no summary")
    if footer["summary_crc"] not in (0, zlib.crc32(data[start : len(data) - len(MAGIC) - 4])):
        raise FormatError("the summary's CRC fails")
    return start


def _length(data: memoryview, start: int) -> int:
    return HEAD.size + int(HEAD.unpack_from(data, start)[1])


def _parts(data: memoryview, end: int, summary: Mapping[int, list[Record]]) -> list[_Part]:
    """The data section's records, each as the summary describes it; FormatError where the two disagree."""
    indexed = {r.fields["chunk_start_offset"]: r.fields["message_index_offsets"] for r in summary.get(CHUNK_INDEX, [])}
    where = {(channel, at) for offsets in indexed.values() for channel, at in offsets.items()}
    parts = [_part(data, op, at, size, indexed) for op, at, size in walk(data, len(MAGIC), end)]
    _agree([p.start for p in parts if p.opcode == CHUNK], indexed, "chunks")
    _agree([(c, p.start) for p in parts if p.opcode == MESSAGE_INDEX for c in p.channels or ()], where, "indexes")
    for opcode, index in ((ATTACHMENT, ATTACHMENT_INDEX), (METADATA, METADATA_INDEX)):
        listed = [r.fields["offset"] for r in summary.get(index, [])]
        _agree([p.start for p in parts if p.opcode == opcode], listed, "attachments or metadata")
    if not parts or parts[-1].opcode != DATA_END:
        raise FormatError("the summary does not follow the end of the data")
    return parts


def _part(data: memoryview, opcode: int, at: int, size: int, indexed: Mapping[int, Mapping[int, int]]) -> _Part:
    start, channels, messages = at - HEAD.size, None, 0
    if opcode == MESSAGE:
        raise FormatError("there are messages outside chunks")
    if opcode == CHUNK:
        channels = frozenset(indexed.get(start, {}))
        if not channels:
            raise FormatError(f"the chunk at byte {start} has no message index")
    elif opcode == MESSAGE_INDEX:
        index = parse(opcode, data[at : at + size]).fields
        channels, messages = frozenset([index["channel_id"]]), len(index["records"]) // 16
    elif opcode == CHANNEL:
        channels = frozenset([int.from_bytes(data[at : at + 2], "little")])
    return _Part(opcode, start, channels, messages)


def _agree(found: Any, listed: Any, what: str) -> None:
    if len(found) != len(listed) or set(found) != set(listed):
        raise FormatError(f"the summary's list of {what} is not what the data hold")


def _ours(summary: Mapping[int, list[Record]], root: str | None) -> frozenset[int]:
    channels = [r.fields for r in summary.get(CHANNEL, [])]
    return frozenset(int(c["id"]) for c in channels if root is not None and str(c["topic"]).startswith(root))


def _cut(parts: list[_Part], ours: frozenset[int], foreign: set[int]) -> int:
    """Where the tail begins that an earlier run appended, at the schemas in front of its first channel; or DataEnd."""
    first = next((i for i, p in enumerate(parts) if (p.channels or frozenset()) & ours), len(parts) - 1)
    tail = parts[first:-1]
    if any(p.opcode == ATTACHMENT or p.start in foreign or not (p.channels or ours) <= ours for p in tail):
        raise FormatError(f"{ROOT} messages lie between others")
    while tail and first and parts[first - 1].opcode == SCHEMA:
        first -= 1
    return parts[first].start


def _crc(data: memoryview, cut: int, end: int) -> int | None:
    """The CRC of the bytes kept; None where the file does not keep one."""
    stored = int(parse(DATA_END, data[end + HEAD.size : end + _DATA_END]).fields["data_section_crc"])
    if not stored:
        return None
    return stored if cut == end else zlib.crc32(data[:cut])


def _contents(
    summary: Mapping[int, list[Record]], raw: Mapping[int, bytes], kept: list[_Part], ours: frozenset[int]
) -> Contents:
    channels = {r.fields["id"]: r for r in summary.get(CHANNEL, []) if r.fields["id"] not in ours}
    used = {r.fields["schema_id"] for r in channels.values()}
    theirs = used | (
        {r.fields["id"] for r in summary.get(SCHEMA, [])}
        - {r.fields["schema_id"] for r in summary.get(CHANNEL, []) if r.fields["id"] in ours}
    )
    contents = Contents(
        schemas={r.fields["id"]: raw[r.start] for r in summary.get(SCHEMA, []) if r.fields["id"] in theirs},
        channels={number: raw[r.start] for number, r in channels.items()},
        counts=dict.fromkeys(channels, 0),
    )
    if not used <= {0, *contents.schemas}:
        raise FormatError("the summary lacks schemas of its channels")
    places = {p.start for p in kept}
    for opcode, place, into in (
        (CHUNK_INDEX, "chunk_start_offset", contents.chunks),
        (ATTACHMENT_INDEX, "offset", contents.attachments),
        (METADATA_INDEX, "offset", contents.metadata),
    ):
        into += [raw[r.start] for r in summary.get(opcode, []) if r.fields[place] in places]
    _count(contents, summary, kept, places)
    return contents


def _count(contents: Contents, summary: Mapping[int, list[Record]], kept: list[_Part], places: set[int]) -> None:
    """Messages per channel by the message indexes, and the span of the chunks kept; the statistics must agree."""
    for part in kept:
        if part.opcode == MESSAGE_INDEX:
            number = next(iter(part.channels or ()))
            if number not in contents.counts:
                raise FormatError(f"the summary lacks channel {number}")
            contents.counts[number] += part.messages
    for record in summary.get(STATISTICS, []):
        stated = record.fields["channel_message_counts"]
        if any(stated.get(number, 0) != count for number, count in contents.counts.items()):
            raise FormatError("the statistics count other messages than the message indexes")
    for record in summary.get(CHUNK_INDEX, []):
        if record.fields["chunk_start_offset"] in places:
            contents.seen(record.fields["message_start_time"], record.fields["message_end_time"])

"""Find the leading bytes of an MCAP that can be kept,
so that more chunks and a new summary can follow them.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import FormatError
from ..topics import PREFIX
from . import opcodes as op
from .record_file import Head, RecordFile
from .records import HEAD, Record, parse_record
from .writer import Contents

NAME = "bodylog"
"""Name of the metadata record that describes how an estimate was made."""

_INDEX_HEAD = 6
_INDEX_ENTRY = 16
_Summary = Mapping[int, list[tuple[Record, bytes]]]
"""Opcode -> the summary's records, parsed and raw."""


@dataclass(frozen=True)
class Prefix:
    """Bytes [0, end) of a file, the summary of their content, and their CRC if the file has one."""

    end: int
    crc: int | None
    contents: Contents


class _DataRecord(NamedTuple):
    """One record of the data section; `channels` are those it refers to, None without any."""

    opcode: int
    start: int
    channels: frozenset[int] | None = None
    messages: int = 0


def reusable_prefix(path: Path) -> Prefix:
    """All of a chunked MCAP with a sound summary, except what an earlier run appended.

    FormatError gives the reason to rewrite the file: it is not chunked, has no summary, or one that
    contradicts the data; or messages under `PREFIX` lie between others; or a name is not UTF-8,
    which other readers reject.
    """
    with RecordFile(path) as file:
        return _reusable_prefix(file, PREFIX)


def count_messages(path: Path) -> int:
    """Count an MCAP's messages by its message indexes; FormatError if summary and data disagree."""
    with RecordFile(path) as file:
        return sum(_reusable_prefix(file, None).contents.counts.values())


def _reusable_prefix(file: RecordFile, root: str | None) -> Prefix:
    start, records = file.summary()
    summary: dict[int, list[tuple[Record, bytes]]] = {}
    for record, raw in records:
        summary.setdefault(record.opcode, []).append((record, raw))
    if root is not None and any(
        map(no_utf8, _records_with_names(file, start, [one for one, _ in records]))
    ):
        raise FormatError("a name in it is not UTF-8")
    file.prefetch(_located_heads(summary))
    parts = _data_section_records(file.heads(start), summary)
    ours = _own_channels(summary, root)
    foreign = {
        r.fields["offset"]
        for r, _ in summary.get(op.METADATA_INDEX, [])
        if r.fields["name"] != NAME
    }
    cut = _find_cut(parts, ours, foreign)
    contents = _kept_contents(summary, [p for p in parts if p.start < cut], ours)
    return Prefix(cut, _kept_bytes_crc(file, cut, parts[-1].start), contents)


def no_utf8(record: Record) -> bool:
    """Whether a text of a record has the replacement character for bytes that are not UTF-8."""
    values = [(*v, *v.values()) if isinstance(v, dict) else (v,) for v in record.fields.values()]
    return any(isinstance(text, str) and "\ufffd" in text for texts in values for text in texts)


def _records_with_names(file: RecordFile, end: int, summary: list[Record]) -> Iterator[Record]:
    """The records that hold names: header, repeated records
    of the summary, and metadata other than bodylog's.
    """
    first = next(file.heads(end), None)
    if first is not None and first.opcode == op.HEADER:
        yield file.fields(first)
    yield from summary
    for record in summary:
        fields = record.fields
        if record.opcode == op.METADATA_INDEX and fields["name"] != NAME:
            raw = memoryview(file.read(fields["offset"], fields["length"]))
            yield parse_record(op.METADATA, raw[HEAD.size :], fields["offset"])


def _located_heads(summary: _Summary) -> Iterator[tuple[int, int]]:
    """Where (byte, size) the summary locates record heads between long contents."""
    for record, _ in summary.get(op.CHUNK_INDEX, []):
        fields = record.fields
        yield fields["chunk_start_offset"], 1
        yield (
            fields["chunk_start_offset"] + fields["chunk_length"],
            fields["message_index_length"] + 1,
        )


def _data_section_records(heads: Iterable[Head], summary: _Summary) -> list[_DataRecord]:
    """The data section's records, each as the summary
    describes it; FormatError where the two disagree.
    """
    chunks = [r.fields for r, _ in summary.get(op.CHUNK_INDEX, [])]
    indexed = {
        fields["chunk_start_offset"]: _shared_channel_set(tuple(fields["message_index_offsets"]))
        for fields in chunks
    }
    parts = [_describe_data_record(head, indexed) for head in heads]
    _require_agreement([p.start for p in parts if p.opcode == op.CHUNK], list(indexed), "chunks")
    found = [(c, p.start) for p in parts if p.opcode == op.MESSAGE_INDEX for c in p.channels or ()]
    _require_agreement(
        found,
        [pair for fields in chunks for pair in fields["message_index_offsets"].items()],
        "message indexes",
    )
    for opcode, index in ((op.ATTACHMENT, op.ATTACHMENT_INDEX), (op.METADATA, op.METADATA_INDEX)):
        listed = [r.fields["offset"] for r, _ in summary.get(index, [])]
        _require_agreement(
            [p.start for p in parts if p.opcode == opcode], listed, "attachments or metadata"
        )
    if not parts or parts[-1].opcode != op.DATA_END:
        raise FormatError("the summary does not follow the end of the data")
    return parts


def _describe_data_record(head: Head, indexed: Mapping[int, frozenset[int]]) -> _DataRecord:
    if head.opcode == op.MESSAGE:
        raise FormatError("there are messages outside chunks")
    if head.opcode == op.CHUNK:
        channels = indexed.get(head.start)
        if not channels:
            raise FormatError(f"the chunk at byte {head.start} has no message index")
        return _DataRecord(op.CHUNK, head.start, channels)
    if head.opcode not in (op.MESSAGE_INDEX, op.CHANNEL):
        return _DataRecord(head.opcode, head.start)
    channel = _shared_channel_set((int.from_bytes(head.first[:2], "little"),))
    size = int.from_bytes(head.first[2:], "little") if head.opcode == op.MESSAGE_INDEX else 0
    if size > max(head.size - _INDEX_HEAD, 0):
        raise FormatError(f"the message index at byte {head.start} is longer than its record")
    return _DataRecord(head.opcode, head.start, channel, size // _INDEX_ENTRY)


@lru_cache
def _shared_channel_set(channels: tuple[int, ...]) -> frozenset[int]:
    """One shared object for equal channel sets: a long log has very many records."""
    return frozenset(channels)


def _require_agreement(found: list[Any], listed: list[Any], what: str) -> None:
    if len(found) != len(listed) or set(found) != set(listed):
        raise FormatError(f"the summary's list of {what} is not what the data hold")


def _own_channels(summary: _Summary, root: str | None) -> frozenset[int]:
    channels = [r.fields for r, _ in summary.get(op.CHANNEL, [])]
    return frozenset(
        int(c["id"]) for c in channels if root is not None and str(c["topic"]).startswith(root)
    )


def _find_cut(parts: list[_DataRecord], ours: frozenset[int], foreign: set[int]) -> int:
    """Where an earlier run's tail begins, at the schemas before its first channel, or DataEnd."""
    first = next(
        (i for i, p in enumerate(parts) if (p.channels or frozenset()) & ours), len(parts) - 1
    )
    tail = parts[first:-1]
    if any(
        p.opcode == op.ATTACHMENT or p.start in foreign or not (p.channels or ours) <= ours
        for p in tail
    ):
        raise FormatError(f"{PREFIX} messages lie between others")
    while tail and first and parts[first - 1].opcode == op.SCHEMA:
        first -= 1
    return parts[first].start


def _kept_bytes_crc(file: RecordFile, cut: int, end: int) -> int | None:
    """The CRC of the kept bytes; None if the file has none."""
    stored = int.from_bytes(file.read(end, 13)[9:], "little")
    if not stored:
        return None
    return stored if cut == end else file.crc(cut)


def _kept_contents(summary: _Summary, kept: list[_DataRecord], ours: frozenset[int]) -> Contents:
    """The summary of the kept parts; FormatError if it lacks something they need."""
    channels = {
        r.fields["id"]: (r, raw)
        for r, raw in summary.get(op.CHANNEL, [])
        if r.fields["id"] not in ours
    }
    used = {r.fields["schema_id"] for r, _ in channels.values()}
    dropped = {
        r.fields["schema_id"] for r, _ in summary.get(op.CHANNEL, []) if r.fields["id"] in ours
    } - used
    schemas = {
        r.fields["id"]: raw
        for r, raw in summary.get(op.SCHEMA, [])
        if r.fields["id"] not in dropped
    }
    if not used <= {0, *schemas}:
        raise FormatError("the summary lacks schemas of its channels")
    counts = dict.fromkeys(channels, 0)
    contents = Contents(
        schemas, {number: raw for number, (_, raw) in channels.items()}, counts=counts
    )
    places = {p.start for p in kept}
    for opcode, place, into in (
        (op.CHUNK_INDEX, "chunk_start_offset", contents.chunks),
        (op.ATTACHMENT_INDEX, "offset", contents.attachments),
        (op.METADATA_INDEX, "offset", contents.metadata),
    ):
        into += [raw for r, raw in summary.get(opcode, []) if r.fields[place] in places]
    _count_kept_messages(contents, summary, kept, places)
    return contents


def _count_kept_messages(
    contents: Contents, summary: _Summary, kept: list[_DataRecord], places: set[int]
) -> None:
    """Messages per channel by the message indexes, and the
    time span of the kept chunks; the statistics must agree.
    """
    for part in kept:
        if part.opcode == op.MESSAGE_INDEX:
            number = next(iter(part.channels or ()))
            if number not in contents.counts:
                raise FormatError(f"the summary lacks channel {number}")
            contents.counts[number] += part.messages
    for record, _ in summary.get(op.STATISTICS, []):
        stated = record.fields["channel_message_counts"]
        if any(stated.get(number, 0) != count for number, count in contents.counts.items()):
            raise FormatError("the statistics count other messages than the message indexes")
    for record, _ in summary.get(op.CHUNK_INDEX, []):
        if record.fields["chunk_start_offset"] in places:
            contents.seen(record.fields["message_start_time"], record.fields["message_end_time"])

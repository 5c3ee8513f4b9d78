"""Compare an MCAP's declarations with its content: statistics, indexes, CRCs, times, offsets."""

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from isal.isal_zlib import crc32

from ...errors import FormatError
from ..diagnostics import Diagnostics
from ..records import Array
from ..storage.compression import Buffer
from ..storage.mmapped import drop_pages
from . import opcodes as op
from .chunks import (
    Chunk,
    MessageRecords,
    chunk_head,
    heads_at,
    index_of,
    list_chunk_messages,
    load_chunk,
)
from .records import HEAD, MAGIC, Record, iter_records, parse_record
from .resync import iterate_sound_records
from .summary import find_summary_section, records_of

Say = Callable[[str, str], None]
"""Reports a finding: its kind and its text."""

_INDEXES = {
    op.ATTACHMENT_INDEX: ("attachment", op.ATTACHMENT),
    op.METADATA_INDEX: ("metadata", op.METADATA),
}


@dataclass
class _Tally:
    """Counts of what was read: messages by channel, log
    times, records by opcode, declared ids; unreadable bytes.
    """

    messages: dict[int, int] = field(default_factory=dict)
    times: list[int] = field(default_factory=list)
    records: dict[int, int] = field(default_factory=dict)
    declared: dict[int, set[int]] = field(
        default_factory=lambda: {op.SCHEMA: set(), op.CHANNEL: set()}
    )
    lost: int = 0

    def add(self, heads: Array) -> None:
        """Count messages by their heads."""
        for channel, count in zip(*np.unique(heads["channel"], return_counts=True), strict=True):
            self.messages[int(channel)] = self.messages.get(int(channel), 0) + int(count)
        if len(heads):
            self.times += [int(heads["log"].min()), int(heads["log"].max())]


def check_mcap(data: memoryview, diagnostics: Diagnostics, say: Say) -> None:
    """Report every disagreement in the MCAP to `say`;
    the reader's own findings cover unreadable parts.
    """
    tally = _Tally()
    buffer = Buffer(diagnostics.path, diagnostics.limits)
    chunk: tuple[Chunk, MessageRecords] | None = None

    def lost(_at: int, size: int) -> None:
        nonlocal chunk
        chunk = None
        tally.lost += size

    for opcode, at, length in iterate_sound_records(data, len(MAGIC), len(data), (), lost):
        tally.records[opcode] = tally.records.get(opcode, 0) + 1
        body = data[at + HEAD.size : at + HEAD.size + length]
        if opcode == op.CHUNK:
            chunk = _check_chunk(data, at, length, tally, buffer, diagnostics, say)
        elif opcode == op.MESSAGE_INDEX and chunk is not None:
            _check_message_index(data, at, chunk, say)
        elif opcode == op.MESSAGE:
            tally.add(heads_at(data, np.array([at])))
        elif opcode in tally.declared:
            tally.declared[opcode].add(parse_record(opcode, body).fields["id"])
        elif opcode == op.ATTACHMENT:
            _check_attachment(at, body, say)
        elif opcode == op.DATA_END:
            _data_end(data, at, body, say)
            break
    with suppress(FormatError):  # the reader reports it
        place = find_summary_section(data)
        _check_summary(data, records_of(data, *place) if place else (), tally, say)


def _check_chunk(
    data: memoryview,
    at: int,
    length: int,
    tally: _Tally,
    buffer: Buffer,
    diagnostics: Diagnostics,
    say: Say,
) -> tuple[Chunk, MessageRecords] | None:
    first, last, *_ = chunk_head(data, at)
    chunk = Chunk(at, HEAD.size + length, first, last)
    content = load_chunk(data, chunk, buffer, diagnostics)
    if content is None:
        tally.lost += chunk.length
        return None
    found = list_chunk_messages(content, data, chunk, diagnostics)
    drop_pages(data, at, at + chunk.length)
    tally.add(found.heads)
    for opcode, start, size in iter_records(content.data, 0, len(content)):
        if opcode in tally.declared:
            tally.declared[opcode].add(
                parse_record(opcode, content.data[start : start + size]).fields["id"]
            )
    if len(found.starts):
        held = int(found.heads["log"].min()), int(found.heads["log"].max())
        if held != (first, last):
            text = f"the chunk at byte {at} declares log times {first} to {last},"
            say("chunk times", f"{text} it holds {held[0]} to {held[1]}")
    return chunk, found


def _check_message_index(
    data: memoryview, at: int, chunk: tuple[Chunk, MessageRecords], say: Say
) -> None:
    """Compare a MessageIndex with the messages of its channel in the chunk before it."""
    channel = int.from_bytes(data[at + HEAD.size : at + HEAD.size + 2], "little")
    listed = index_of(data, at)
    mine = chunk[1].heads["channel"] == channel
    held = np.column_stack((chunk[1].heads["log"][mine], chunk[1].starts[mine]))
    where = f"the message index of channel {channel} at byte {at}"
    if len(listed) != len(held):
        say("index", f"{where} lists {len(listed)} messages, the chunk holds {len(held)}")
    elif set(map(tuple, listed.tolist())) != set(map(tuple, held.tolist())):
        say("index", f"{where} gives offsets or log times that are not those of the messages")


def _check_attachment(at: int, body: memoryview, say: Say) -> None:
    declared = int.from_bytes(body[-4:], "little")
    found = crc32(body[:-4])
    if declared and declared != found:
        say(
            "attachment",
            f"the attachment at byte {at} has CRC {found:08x} where {declared:08x} is declared",
        )


def _data_end(data: memoryview, at: int, body: memoryview, say: Say) -> None:
    declared = int.from_bytes(body[:4], "little")
    if declared == 0:
        return
    found = 0
    for low in range(0, at, 1 << 24):
        found = crc32(data[low : min(at, low + (1 << 24))], found)
        drop_pages(data, low, low + (1 << 24))
    if found != declared:
        say("data", f"the data section has CRC {found:08x} where {declared:08x} is declared")


def _check_summary(data: memoryview, records: Iterable[Record], tally: _Tally, say: Say) -> None:
    listed = 0
    for record in records:
        fields = record.fields
        listed += record.opcode == op.CHUNK_INDEX
        if record.opcode == op.STATISTICS and not tally.lost:
            _check_mcap_statistics(fields, tally, say)
        elif record.opcode == op.CHUNK_INDEX:
            _chunk_index(data, fields, say)
        elif record.opcode in _INDEXES:
            name, opcode = _INDEXES[record.opcode]
            _check_index_target(
                data, fields["offset"], fields["length"], opcode, f"the {name} index", say
            )
        elif record.opcode == op.SUMMARY_OFFSET:
            _check_summary_group(data, fields, say)
    if listed and not tally.lost and listed != tally.records.get(op.CHUNK, 0):
        say(
            "chunk index",
            f"the summary lists {listed} chunks, the file holds {tally.records.get(op.CHUNK, 0)}",
        )


def _check_mcap_statistics(fields: dict[str, Any], tally: _Tally, say: Say) -> None:
    held = {
        "message_count": sum(tally.messages.values()),
        "schema_count": len(tally.declared[op.SCHEMA]),
        "channel_count": len(tally.declared[op.CHANNEL]),
        "attachment_count": tally.records.get(op.ATTACHMENT, 0),
        "metadata_count": tally.records.get(op.METADATA, 0),
        "chunk_count": tally.records.get(op.CHUNK, 0),
        "message_start_time": min(tally.times, default=0),
        "message_end_time": max(tally.times, default=0),
    }
    for name, value in held.items():
        if fields[name] != value:
            say(
                f"statistics {name}",
                f"the statistics say {name} {fields[name]}, the file holds {value}",
            )
    by_channel = {
        channel: count for channel, count in fields["channel_message_counts"].items() if count
    }
    for channel in sorted(by_channel.keys() | tally.messages.keys()):
        if by_channel and by_channel.get(channel, 0) != tally.messages.get(channel, 0):
            declared = by_channel.get(channel, 0)
            count = tally.messages.get(channel, 0)
            text = f"the statistics say {declared} messages on channel {channel}"
            say("statistics channel", f"{text}, the file holds {count}")


def _chunk_index(data: memoryview, fields: dict[str, Any], say: Say) -> None:
    start = fields["chunk_start_offset"]
    try:
        first, last, size, _, compression, packed = chunk_head(data, start)
    except FormatError:
        say("chunk index", f"the chunk index points to byte {start}, where there is no chunk")
        return
    held = (first, last, size, compression, len(packed))
    names = (
        "message_start_time",
        "message_end_time",
        "uncompressed_size",
        "compression",
        "compressed_size",
    )
    for name, value in zip(names, held, strict=True):
        if fields[name] != value:
            text = f"the chunk index says {name} {fields[name]} of the chunk at byte {start}"
            say(f"chunk index {name}", f"{text}, which has {value}")
    for channel, at in fields["message_index_offsets"].items():
        if (
            at + HEAD.size > len(data)
            or data[at] != op.MESSAGE_INDEX
            or data[at + HEAD.size] != channel & 255
        ):
            say(
                "chunk index offset",
                f"the chunk index says channel {channel} is indexed at byte {at}: it is not",
            )


def _check_index_target(
    data: memoryview, at: int, length: int, opcode: int, name: str, say: Say
) -> None:
    inside = 0 <= at <= len(data) - HEAD.size
    if not inside or HEAD.unpack_from(data, at) != (opcode, length - HEAD.size):
        say(name, f"{name} points to {length} bytes at byte {at}, which are not such a record")


def _check_summary_group(data: memoryview, fields: dict[str, Any], say: Say) -> None:
    start = fields["group_start"]
    end = fields["group_start"] + fields["group_length"]
    if start == end:
        return
    try:
        opcodes = {opcode for opcode, _, _ in iter_records(data, start, min(end, len(data)))}
    except FormatError:
        opcodes = set()
    if opcodes != {fields["group_opcode"]}:
        say(
            "summary offset",
            f"the summary offset of opcode {fields['group_opcode']} points to others at byte "
            f"{start}",
        )

"""Read MCAP files as undecoded batches; only what requested topics need is read."""

import os
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from isal.isal_zlib import crc32

from ...errors import FormatError
from ..diagnostics import Diagnostics
from ..limits import LIMITS, Input
from ..mapped_log import MappedLog
from ..records import Array, Batch, Topic
from ..storage.compression import STORED, Buffer
from ..storage.mmapped import advise_sequential, drop_pages, ensure_local
from ..storage.packed_files import decompress_messages
from ..topics import TopicTable, log_time_span, split_by_topic_id
from .chunks import (
    MESSAGE_HEAD,
    Chunk,
    LooseRecords,
    MessageRecords,
    chunk_head,
    list_chunk_messages,
    list_indexed_messages,
    loose_messages,
    record_loss,
    records_at,
    unpack_chunk,
)
from .records import HEAD, MAGIC, Record, parse_record
from .survey import McapSurvey, spans_of

_TOGETHER = 16 << 20


if TYPE_CHECKING:
    from concurrent.futures import Future, ThreadPoolExecutor


_SMALL = 4 << 20
"""Bytes of a log that decompress faster than a thread starts."""


_SHORT = 1 << 14


_LONG = 8 << 20
"""Packed bytes: handing over a shorter chunk costs more
than it saves; two longer ones take too much memory.
"""


Unpacked = Array | FormatError | None
"""A chunk's records, or why there are none; None for messages outside chunks."""


class McapLog(MappedLog):
    """One memory-mapped MCAP file; see protocol.Log."""

    format = "mcap"

    def __init__(
        self, path: Path, strict: bool = False, source: Path | None = None, limits: Input = LIMITS
    ) -> None:
        """Map `source` (default: `path`) and survey it; LogError if strict and data is lost."""
        from .scan import survey_mcap

        super().__init__(path, strict, source, limits)
        self.survey = survey_mcap(self._data, self._diagnostics)
        self.topics, self._topic_of = _topics_by_channel(self.survey, self._diagnostics)
        self.start_ns, self.end_ns = log_time_span(self.survey.times, self._diagnostics)

    def batches(self, ids: Collection[int] | None = None) -> Iterator[Batch]:
        """Messages of the topics `ids` (None: all) in file
        order, one batch per topic and chunk or block.
        """
        topic_of = self._topic_of.copy()
        if ids is not None:
            known = np.zeros(len(self.topics) + 1, bool)  # index -1 stands for no topic
            known[[number for number in ids if 0 <= number < len(self.topics)]] = True
            topic_of[~known[topic_of]] = -1
        found = self.messages(topic_of >= 0)
        batches = (
            batch for content, some in found for batch in _split_by_topic(content, some, topic_of)
        )
        yield from decompress_messages(batches, self.topics, self._diagnostics)

    def messages(self, wanted: Array | None = None) -> Iterator[tuple[Array, MessageRecords]]:
        """The bytes of each chunk and the messages in them;
        chunks without a channel `wanted` (65536,) are skipped.
        """
        done = 0
        channels = None if wanted is None else frozenset(np.flatnonzero(wanted).tolist())
        parts = [part for part in self.survey.parts if _may_hold_channels(part, channels)]
        alone = 2 * len(parts) < len(self.survey.parts)
        for some in group_uncompressed_chunks(parts):
            found = read_uncompressed_run(self._data, some, alone)
            if found is None:
                yield from self._one_by_one(some, alone)
                continue
            yield found
            # not this run, whose images may still be in use
            drop_pages(self._data, done, some[0].start)
            done = some[0].start
        drop_pages(self._data, done, len(self._data))

    def _one_by_one(
        self, parts: Sequence[Chunk | LooseRecords], alone: bool
    ) -> Iterator[tuple[Array, MessageRecords]]:
        done = parts[0].start
        for part, content in unpacked_parts(self._data, parts, self._diagnostics, alone):
            if isinstance(part, LooseRecords):
                advise_sequential(self._data, part.start, part.end)
                whole = np.frombuffer(self._data, np.uint8)
                for found in loose_messages(self._data, part):
                    yield whole, found
                    drop_pages(
                        self._data,
                        int(found.starts[0]),
                        int(found.starts[-1] + found.heads["size"][-1]),
                    )
                continue
            if isinstance(content, FormatError):
                record_loss(self._data, part, content, self._diagnostics)
            elif content is not None:
                yield content, list_chunk_messages(content, self._data, part, self._diagnostics)
            # and the pages touched since the last chunk
            drop_pages(self._data, done, part.start + part.length)
            done = part.start + part.length

    def spans(self) -> dict[int, tuple[int, int]]:
        """First and last log time (ns) by topic id, if every message is in a message index."""
        return spans_of(self._data, self.survey.parts, self._topic_of)

    def records(self, opcode: int) -> Iterator[Record]:
        """The sound records of that opcode outside chunks."""
        from .resync import iterate_sound_records

        ensure_local(self._data, 0, len(self._data))
        for found, at, length in iterate_sound_records(
            self._data, len(MAGIC), len(self._data), (), lambda _at, _size: None
        ):
            if found == opcode:
                yield parse_record(opcode, self._data[at + HEAD.size : at + HEAD.size + length], at)


def _may_hold_channels(part: Chunk | LooseRecords, wanted: frozenset[int] | None) -> bool:
    """Whether the part may hold messages of the channels `wanted`."""
    if wanted is None or isinstance(part, LooseRecords) or not part.listed or not part.indexes:
        return True
    return not wanted.isdisjoint(part.indexes)


def _topics_by_channel(
    survey: McapSurvey, diagnostics: Diagnostics
) -> tuple[tuple[Topic, ...], Array]:
    """The topics, and a table (65536,) from channel id to topic id, -1 for undeclared channels."""
    topics = TopicTable()
    topic_of = np.full(1 << 16, -1, np.int64)
    for channel, record in survey.channels.items():
        fields = record.fields
        schema = survey.schemas.get(fields["schema_id"])
        name = ""
        encoding = ""
        data = b""
        if schema is not None:
            name = schema.fields["name"]
            encoding = schema.fields["encoding"]
            data = schema.fields["data"]
        elif fields["schema_id"] and channel in survey.counts:
            diagnostics.warn(
                f"topic {fields['topic']}: schema {fields['schema_id']} is missing; its "
                "messages are undefined"
            )
        count = survey.counts.get(channel, 0)
        topic_of[channel] = topics.add(
            fields["topic"],
            name,
            fields["message_encoding"],
            data,
            encoding,
            count,
            fields["metadata"],
        )
    return topics.all(), topic_of


def _split_by_topic(content: Array, found: MessageRecords, topic_of: Array) -> Iterator[Batch]:
    heads = found.heads
    offset = found.starts + MESSAGE_HEAD.itemsize
    length = heads["size"] - (MESSAGE_HEAD.itemsize - HEAD.size)
    return split_by_topic_id(topic_of[heads["channel"]], heads["log"], content, offset, length)


def unpacked_parts(
    data: memoryview,
    parts: Sequence[Chunk | LooseRecords],
    diagnostics: Diagnostics,
    alone: bool = False,
) -> Iterator[tuple[Chunk | LooseRecords, Unpacked]]:
    """Each part with its decompressed records, valid
    until the next; `alone`: nothing between is needed.
    """
    if len(parts) < 3 or parts[-1].start - parts[0].start < _SMALL or _count_processors() < 2:
        buffer = Buffer(diagnostics.path, diagnostics.limits)
        yield from ((part, _unpack_part(data, part, buffer, alone)) for part in parts)
        return
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as pool:
        yield from _overlap_unpacking(data, parts, pool, diagnostics, alone)


def _overlap_unpacking(
    data: memoryview,
    parts: Sequence[Chunk | LooseRecords],
    pool: "ThreadPoolExecutor",
    diagnostics: Diagnostics,
    alone: bool,
) -> Iterator[tuple[Chunk | LooseRecords, Unpacked]]:
    """Alternate between two buffers; the first part is not
    overlapped, as some callers read only a log's beginning.
    """
    here = Buffer(diagnostics.path, diagnostics.limits)
    there = Buffer(diagnostics.path, diagnostics.limits)
    waiting: Future[Unpacked] | None = None
    for number, part in enumerate(parts):
        found = waiting.result() if waiting else _unpack_part(data, part, here, alone)
        following = parts[number + 1] if 0 < number < len(parts) - 1 else None
        pays = isinstance(following, Chunk) and _SHORT <= following.length <= _LONG
        waiting = (
            pool.submit(_unpack_part, data, following, there, alone) if following and pays else None
        )
        yield part, found
        here, there = there, here


def _unpack_part(
    data: memoryview, part: Chunk | LooseRecords, buffer: Buffer, alone: bool
) -> Unpacked:
    if isinstance(part, LooseRecords):
        return None
    advise_sequential(data, part.start, part.start + part.length, alone)
    try:
        return unpack_chunk(data, part, buffer)
    except FormatError as problem:
        return problem


def _count_processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def group_uncompressed_chunks(
    parts: Sequence[Chunk | LooseRecords],
) -> Iterator[list[Chunk | LooseRecords]]:
    """The parts in order, with uncompressed chunks
    grouped that begin in the same 16 MB of the file.

    The first part is alone, as some callers read only a log's beginning.
    """

    def key(part: Chunk | LooseRecords) -> tuple[bool, int]:
        if isinstance(part, LooseRecords) or not part.stored or not part.indexes:
            return False, 0
        return True, 0 if part is parts[0] else 1 + part.start // _TOGETHER

    return (list(some) for _, some in groupby(parts, key))


def read_uncompressed_run(
    data: memoryview, parts: Sequence[Chunk | LooseRecords], alone: bool
) -> tuple[Array, MessageRecords] | None:
    """The file (bytes,) uint8 and all messages in a run of uncompressed chunks.

    `alone`: the bytes around it are not needed. None when the run holds other parts, or a CRC or
    index in it is wrong: read each part separately.
    """
    chunks = [part for part in parts if isinstance(part, Chunk) and part.stored and part.indexes]
    if len(chunks) < len(parts):
        return None
    for first, last in [(c, c) for c in chunks] if alone else [(chunks[0], chunks[-1])]:
        advise_sequential(data, first.start, last.start + last.length, alone)
    places = [place for chunk in chunks if (place := _sound_chunk_bounds(data, chunk))]
    whole = np.frombuffer(data, np.uint8)
    found = (
        list_indexed_messages(whole, places, data, chunks) if len(places) == len(chunks) else None
    )
    return None if found is None else (whole, found)


def _sound_chunk_bounds(data: memoryview, chunk: Chunk) -> tuple[int, int] | None:
    """Where in the file an uncompressed chunk's records are; None when its head or CRC is wrong."""
    with suppress(FormatError):
        _, _, size, crc, compression, packed = chunk_head(data, chunk.start)
        if compression in STORED and len(packed) == size and (not crc or crc32(packed) == crc):
            low = records_at(chunk, compression)
            return low, low + size
    return None

"""Read MCAP files as undecoded batches; only what the requested topics need is read."""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

import numpy as np

from ...errors import FormatError
from ..diagnostics import Diagnostics
from ..limits import LIMITS, Input
from ..mapped_log import MappedLog
from ..records import Array, Batch, Topic
from ..storage.mmapped import advise_sequential, drop_pages, ensure_local
from ..storage.packed_files import decompress_messages
from ..topics import TopicTable, log_time_span, split_by_topic_id
from .chunks import (
    MESSAGE_HEAD,
    Chunk,
    LooseRecords,
    MessageRecords,
    list_chunk_messages,
    loose_messages,
    record_loss,
)
from .prefetch import unpacked_parts
from .records import HEAD, MAGIC, Record, parse_record
from .survey import McapSurvey
from .time_ranges import spans_of
from .uncompressed import group_uncompressed_chunks, read_uncompressed_run


class McapLog(MappedLog):
    """One memory-mapped MCAP file; see protocol.Log."""

    format = "mcap"

    def __init__(
        self, path: Path, strict: bool = False, source: Path | None = None, limits: Input = LIMITS
    ) -> None:
        """Map `source` (default: `path`) and survey
        it; LogError when strict and something is lost.
        """
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

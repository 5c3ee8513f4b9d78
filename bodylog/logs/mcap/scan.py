"""Survey an MCAP in any state: by its summary, by its
records, and past damage to the next sound record.
"""

import struct
from pathlib import Path

import numpy as np

from ...errors import FormatError
from ..diagnostics import Diagnostics
from ..records import Array
from ..storage.compression import STORED, Buffer
from ..storage.mmapped import drop_pages, ensure_local
from . import opcodes as op
from .chunks import (
    Chunk,
    LooseRecords,
    chunk_head,
    heads_at,
    index_of,
    list_chunk_messages,
    load_chunk,
    unpack_chunk,
)
from .records import HEAD, MAGIC, iter_records, parse_record
from .resync import iterate_sound_records
from .summary import Summary, summary_of, use_statistics
from .survey import McapSurvey

_BLOCK = 4096
_BLOCK_BYTES = 16 << 20
_LONGEST_NS = 86400 * 10**9
_CHANNEL = struct.Struct("<H")
_MESSAGE = struct.Struct("<HIQ")
_INDEX_HEAD = 6
_TIMES = struct.Struct("<QQ")


def survey_mcap(data: memoryview, diagnostics: Diagnostics) -> McapSurvey:
    """Survey the file; damage and contradictions go to the diagnostics."""
    survey = None
    try:
        summary = summary_of(data)
        if summary:
            survey = _survey_by_summary(data, summary, diagnostics)
    except FormatError as problem:
        diagnostics.warn(f"the summary is not used: {problem}")
    if survey is None:
        survey = McapSurvey()
        last = _scan_mcap_records(data, len(MAGIC), len(data), survey, diagnostics)
        if last == op.DATA_END or (last == op.FOOTER and data[-len(MAGIC) :] != MAGIC):
            diagnostics.warn("the file ends inside its summary or footer; all data come before")
        elif last is None:
            diagnostics.add_loss(
                len(data),
                0,
                None,
                None,
                "the file ends without its footer: data after that are missing",
            )
        _count_chunk_messages(data, survey, diagnostics)
    for channel in survey.counts.keys() - survey.channels.keys():
        diagnostics.add_loss(
            -channel - 1, 0, survey.counts[channel], None, f"no record declares channel {channel}"
        )
    return survey


def _survey_by_summary(data: memoryview, summary: Summary, diagnostics: Diagnostics) -> McapSurvey:
    survey = McapSurvey()
    at = len(MAGIC)
    for record in summary.records:
        if record.opcode in (op.SCHEMA, op.CHANNEL):
            survey.declare(record)
    for chunk, end in summary.chunks:
        if at != chunk.start:
            _scan_mcap_records(data, at, chunk.start, survey, diagnostics)
        survey.parts.append(chunk)
        at = end
    _scan_mcap_records(data, at, summary.start, survey, diagnostics)
    if not use_statistics(summary, survey, diagnostics):
        _count_chunk_messages(data, survey, diagnostics)
    return survey


def _scan_mcap_records(
    data: memoryview, start: int, end: int, survey: McapSurvey, diagnostics: Diagnostics
) -> int | None:
    """Survey the records between two bytes; returns FOOTER
    or DATA_END if met, CHUNK if the file is truncated.
    """
    if start == end:
        return None
    ensure_local(data, start, end)
    run = _LooseRun(data, survey, start, diagnostics)
    ended = None
    unsummarised = end == len(data)

    def lost(at: int, size: int) -> None:
        run.close(at + size)
        if ended:
            diagnostics.warn(f"{size} bytes from byte {at}, after the end of the data, are damaged")
            return
        cut = _find_truncated_chunk(data, at) if at + size == len(data) else None
        if cut is None:
            diagnostics.add_loss(
                at,
                size,
                None,
                _truncated_chunk_duration(data, at),
                "no whole record can be read there",
            )
        else:
            why = (
                f"the file ends in this chunk, after {size} bytes, which are read without their "
                "checksum"
            )
            diagnostics.add_loss(at, None, None, None, why)
        run.chunk = None
        run.loss = at
        run.is_cut = at + size == end
        if survey.parts and isinstance(survey.parts[-1], Chunk):
            survey.parts[-1] = survey.parts[-1]._replace(indexes={})
        survey.parts += [cut] if cut else []

    def many(starts: Array, after: int) -> bool:
        chunked = survey.parts and isinstance(survey.parts[-1], Chunk)
        if unsummarised and (chunked or int(starts[0]) == len(MAGIC)):
            return False
        run.extend(starts, after)
        return True

    for opcode, at, length in iterate_sound_records(
        data, start, end, survey.channels.keys(), lost, many
    ):
        ended = opcode if opcode in (op.FOOTER, op.DATA_END) else ended
        if (
            opcode == op.MESSAGE
            and unsummarised
            and (at == len(MAGIC) or not run.credible(at, length))
        ):
            lost(at, HEAD.size + length)
        elif opcode == op.MESSAGE:
            run.add(at, at + HEAD.size + length)
        elif opcode in (op.SCHEMA, op.CHANNEL):
            survey.declare(parse_record(opcode, data[at + HEAD.size : at + HEAD.size + length], at))
        elif opcode == op.CHUNK:
            run.close(at + HEAD.size + length)
            first, last, _, _, compression, _ = chunk_head(data, at)
            run.follow(Chunk(at, HEAD.size + length, first, last, stored=compression in STORED))
        elif opcode == op.MESSAGE_INDEX:
            run.index(at)
    run.close(end)
    return ended or (op.CHUNK if run.is_cut else None)


class _LooseRun:
    """Consecutive messages outside chunks."""

    def __init__(
        self, data: memoryview, survey: McapSurvey, start: int, diagnostics: Diagnostics
    ) -> None:
        self._data = data
        self._diagnostics = diagnostics
        self._survey = survey
        self._start = start
        self._end = start
        self._found: list[int] = []
        self.chunk: Chunk | None = None
        self.loss: int | None = None
        self.is_cut = False

    def add(self, start: int, end: int) -> None:
        """Count the message between two bytes."""
        self._end = end
        self._found.append(start)
        if len(self._found) == _BLOCK or end - self._found[0] > _BLOCK_BYTES:
            self._flush()

    def extend(self, starts: Array, end: int) -> None:
        """Count consecutive messages (n,) up to byte `end`."""
        self._flush()
        self._end = end
        self._count(starts)

    def close(self, following: int) -> None:
        """End the run and add it to the survey if it has
        messages; the next run starts at byte `following`.
        """
        self._flush()
        if self._end > self._start:
            self._survey.parts.append(LooseRecords(self._start, self._end))
        self._start = following
        self._end = following

    def credible(self, at: int, length: int) -> bool:
        """Whether a message outside chunks in a chunked file
        is real, not an index or channel with a flipped bit.
        """
        chunks = [part for part in self._survey.parts[-1:] if isinstance(part, Chunk)]
        if not chunks:
            return True
        _, listed, log_ns = _MESSAGE.unpack_from(self._data, at + HEAD.size)
        near = chunks[0].start_ns - _LONGEST_NS <= log_ns <= chunks[0].end_ns + _LONGEST_NS
        return bool(near and listed != length - _INDEX_HEAD)

    def follow(self, chunk: Chunk) -> None:
        """Add a chunk; an earlier loss lies between it and the chunk before."""
        parts = self._survey.parts
        before = parts[-1].end_ns if parts and isinstance(parts[-1], Chunk) else None
        if (
            self.loss is not None
            and before is not None
            and 0 <= chunk.start_ns - before < _LONGEST_NS
        ):
            self._diagnostics.set_duration(self.loss, (chunk.start_ns - before) / 1e9)
        self.chunk = chunk
        self.loss = None
        parts.append(chunk)

    def index(self, at: int) -> None:
        """Assign a MessageIndex to the chunk before it,
        or count the messages of a lost chunk by it.
        """
        if self.chunk is not None:
            (channel,) = _CHANNEL.unpack_from(self._data, at + HEAD.size)
            self.chunk = self.chunk._replace(indexes={**self.chunk.indexes, channel: at})
            self._survey.parts[-1] = self.chunk
        elif self.loss is not None:
            self._diagnostics.add_messages(self.loss, len(index_of(self._data, at)))

    def _flush(self) -> None:
        if self._found:
            self._count(np.array(self._found, np.int64))
        self._found = []

    def _count(self, starts: Array) -> None:
        heads = heads_at(self._data, starts)
        self._survey.count(heads["channel"], heads["log"])
        drop_pages(self._data, int(starts[0]), self._end)


def _count_chunk_messages(data: memoryview, survey: McapSurvey, diagnostics: Diagnostics) -> None:
    """Count the messages of every chunk: by its indexes
    if all channels are known, else by opening it.
    """
    buffer = Buffer(diagnostics.path, diagnostics.limits)
    unopened = []
    for chunk in [part for part in survey.parts if isinstance(part, Chunk)]:
        if chunk.indexes and survey.knows(chunk.indexes):
            for channel, at in chunk.indexes.items():
                times = index_of(data, at)[:, 0]
                survey.count(np.full(len(times), channel), times)
            unopened.append(chunk)
            continue
        content = load_chunk(data, chunk, buffer, diagnostics)
        if content is not None:
            _declare_channels(content.data, survey)
            heads = list_chunk_messages(content, data, chunk, diagnostics).heads
            survey.count(heads["channel"], heads["log"])
            if chunk.cut and len(heads):
                diagnostics.set_duration(
                    chunk.start, max(0, chunk.end_ns - int(heads["log"].max())) / 1e9
                )
        drop_pages(data, chunk.start, chunk.start + chunk.length)
    for chunk in unopened:  # a chunk may hold a schema but no message of it
        if survey.knows(survey.counts):
            return
        content = load_chunk(data, chunk, buffer, diagnostics)
        if content is not None:
            _declare_channels(content.data, survey)
        drop_pages(data, chunk.start, chunk.start + chunk.length)


def _declare_channels(content: memoryview, survey: McapSurvey) -> None:
    try:
        for opcode, at, length in iter_records(content, 0, len(content)):
            if opcode in (op.SCHEMA, op.CHANNEL):
                survey.declare(parse_record(opcode, content[at : at + length], at))
    except FormatError:
        return  # messages() reads the same records and reports where they end


def _find_truncated_chunk(data: memoryview, at: int) -> Chunk | None:
    """The chunk at byte `at` in which the file ends, if there is one with at least one message."""
    try:
        first, last, *_ = chunk_head(data, at, cut=True)
        chunk = Chunk(at, len(data) - at, first, last, cut=True)
        content = unpack_chunk(data, chunk, Buffer())
    except FormatError:
        return None
    return (
        chunk
        if len(list_chunk_messages(content, data, chunk, Diagnostics(Path())).starts)
        else None
    )


def _truncated_chunk_duration(data: memoryview, at: int) -> float | None:
    """Duration of the truncated chunk at `at` by its header, if that is complete."""
    if len(data) - at < HEAD.size + 16 or data[at] != op.CHUNK:
        return None
    first, last = _TIMES.unpack_from(data, at + HEAD.size)
    return (last - first) / 1e9 if 0 <= last - first < _LONGEST_NS else None

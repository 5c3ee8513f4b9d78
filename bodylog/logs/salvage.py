"""Survey an MCAP whatever state it is in: by its summary, by its records, and past damage to the next sound record."""

import struct
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace

import numpy as np

from ..errors import FormatError
from ..types import Array
from .chunks import MESSAGE_HEAD, Chunk, Loose, chunk_head, heads_at, heads_of, index_of, load, messages
from .compression import NAMES, Buffer
from .ledger import Ledger
from .mapping import forget
from .mcap import Survey
from .records import (
    CHANNEL,
    CHUNK,
    DATA_END,
    FIELDS,
    FOOTER,
    HEAD,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    SCHEMA,
    Record,
    parse,
    walk,
)
from .summary import believe_counts, chunks_of, summary_of

_WINDOW = 1 << 20
_BLOCK = 4096
_CHUNK_FIXED = 40
_LONGEST_NS = 86400 * 10**9
_CHANNEL = struct.Struct("<H")
_TIMES = struct.Struct("<QQ")
_SHORTEST = MESSAGE_HEAD.itemsize - HEAD.size

Found = tuple[int, int, int]
"""A record: opcode, where it starts, length of its body."""


def survey_of(data: memoryview, ledger: Ledger) -> Survey:
    """What the file holds; damage and doubts go to the ledger."""
    survey = None
    try:
        records = summary_of(data)
        if records:
            survey = _summarised(data, records, ledger)
    except FormatError as problem:
        ledger.warn(f"the summary is not used: {problem}")
    if survey is None:
        survey = Survey()
        if not _scan(data, len(MAGIC), len(data), survey, ledger):
            ledger.lost(len(data), 0, None, None, "the file ends without its footer: what came after is not there")
        _learn(data, survey, ledger)
    for channel in survey.counts.keys() - survey.channels.keys():
        ledger.lost(-channel - 1, 0, survey.counts[channel], None, f"no record says what channel {channel} is")
    return survey


def _summarised(data: memoryview, records: list[Record], ledger: Ledger) -> Survey:
    survey, at = Survey(), len(MAGIC)
    for record in records:
        if record.opcode in (SCHEMA, CHANNEL):
            survey.declare(record)
    for chunk, end in chunks_of(data, records):
        _scan(data, at, chunk.start, survey, ledger)
        survey.parts.append(chunk)
        at = end
    _scan(data, at, records[0].start, survey, ledger)
    if not believe_counts(records, survey, ledger):
        _learn(data, survey, ledger)
    return survey


def _scan(data: memoryview, start: int, end: int, survey: Survey, ledger: Ledger) -> bool:
    """Add what lies between two bytes to the survey; whether a footer or the end of the data section was there."""
    run, ended = _Run(data, survey, start), False

    def lost(at: int, size: int) -> None:
        run.close(at + size)
        if ended:
            ledger.warn(f"{size} bytes from byte {at}, after the end of the data, are damaged")
            return
        ledger.lost(at, size, None, _seconds(data, at), "no whole record can be read there")
        if survey.parts and isinstance(survey.parts[-1], Chunk):
            survey.parts[-1] = replace(survey.parts[-1], indexes={})

    for opcode, at, length in sound_records(data, start, end, survey.channels.keys(), lost):
        ended = ended or opcode in (FOOTER, DATA_END)
        if opcode == MESSAGE:
            run.add(at, at + HEAD.size + length)
        elif opcode in (SCHEMA, CHANNEL):
            survey.declare(parse(opcode, data[at + HEAD.size : at + HEAD.size + length], at))
        elif opcode == CHUNK:
            run.close(at + HEAD.size + length)
            first, last, *_ = chunk_head(data, at)
            survey.parts.append(Chunk(at, HEAD.size + length, first, last))
        elif opcode == MESSAGE_INDEX and survey.parts and isinstance(survey.parts[-1], Chunk):
            (channel,) = _CHANNEL.unpack_from(data, at + HEAD.size)
            survey.parts[-1] = replace(survey.parts[-1], indexes={**survey.parts[-1].indexes, channel: at})
    run.close(end)
    return ended


class _Run:
    """Messages outside chunks, counted until something else interrupts them."""

    def __init__(self, data: memoryview, survey: Survey, start: int) -> None:
        self._data = data
        self._survey = survey
        self._start = start
        self._end = start
        self._found: list[int] = []

    def add(self, start: int, end: int) -> None:
        """Count the message between two bytes."""
        self._end = end
        self._found.append(start)
        if len(self._found) == _BLOCK:
            self._flush()

    def close(self, following: int) -> None:
        """End the run, a part of the survey if there were messages in it; the next starts at byte `following`."""
        self._flush()
        if self._end > self._start:
            self._survey.parts.append(Loose(self._start, self._end))
        self._start = self._end = following

    def _flush(self) -> None:
        heads = heads_at(self._data, np.array(self._found, np.int64))
        self._survey.count(heads["channel"], heads["log"])
        if self._found:
            forget(self._data, self._found[0], self._end)
        self._found = []


def _learn(data: memoryview, survey: Survey, ledger: Ledger) -> None:
    """Count the messages of every chunk: by its indexes where all their channels are known, else by opening it."""
    buffer = Buffer()
    for chunk in [part for part in survey.parts if isinstance(part, Chunk)]:
        if chunk.indexes and survey.knows(chunk.indexes):
            for channel, at in chunk.indexes.items():
                times = index_of(data, at)[:, 0]
                survey.count(np.full(len(times), channel), times)
            continue
        content = load(data, chunk, buffer, ledger)
        if content is not None:
            _declare(content.data, survey)
            heads = messages(content, data, chunk, ledger).heads
            survey.count(heads["channel"], heads["log"])
        forget(data, chunk.start, chunk.start + chunk.length)


def _declare(content: memoryview, survey: Survey) -> None:
    try:
        for opcode, at, length in walk(content, 0, len(content)):
            if opcode in (SCHEMA, CHANNEL):
                survey.declare(parse(opcode, content[at : at + length], at))
    except FormatError:
        return  # messages() walks the same records and reports where they end


def sound_records(
    data: memoryview, start: int, end: int, channels: Collection[int], lost: Callable[[int, int], None]
) -> Iterator[Found]:
    """Records between two bytes, found again after each damage, which `lost(start, size)` is told of."""
    at = start
    held: Found | None = None
    while at < end:
        opcode, length = HEAD.unpack_from(data, at) if end - at >= HEAD.size else (0, 0)
        if (opcode == MESSAGE and _SHORTEST <= length <= end - at - HEAD.size) or _plausible(data, at, end):
            if held:
                yield held
            held = (opcode, at, length)
            at += HEAD.size + length
            if opcode == FOOTER:
                break
            continue
        found = resync(data, at if held is None or held[0] == CHUNK else held[1] + 1, end, channels)
        begin = at
        if held and found is not None and found < at:  # the length of the record before was the lie
            begin = held[1]
        elif held:
            yield held
        held = None
        at = end if found is None else found
        lost(begin, at - begin)
    if held:
        yield held


def _plausible(data: memoryview, at: int, end: int) -> bool:
    if end - at < HEAD.size:
        return False
    opcode, length = HEAD.unpack_from(data, at)
    if opcode == 0 or length > end - at - HEAD.size:
        return False
    if opcode == MESSAGE:
        return bool(length >= _SHORTEST)
    try:
        if opcode == CHUNK:
            chunk_head(data, at)
        elif opcode in FIELDS:
            parse(opcode, data[at + HEAD.size : at + HEAD.size + length])
    except FormatError:
        return False
    return True


def _seconds(data: memoryview, at: int) -> float | None:
    """How long the chunk that was cut at `at` lasted by its header, if enough of that is left."""
    if len(data) - at < HEAD.size + 16 or data[at] != CHUNK:
        return None
    first, last = _TIMES.unpack_from(data, at + HEAD.size)
    return (last - first) / 1e9 if 0 <= last - first < _LONGEST_NS else None


def resync(data: memoryview, start: int, end: int, channels: Collection[int]) -> int | None:
    """The first byte from `start` where a record convincingly begins, or None."""
    known = np.zeros(1 << 16, bool)
    known[list(channels)] = True
    for low in range(start, end, _WINDOW):
        high = min(end, low + _WINDOW + MESSAGE_HEAD.itemsize - 1)
        for at in _candidates(data[low:high], end - low, known):
            if _convincing(data, low + at, end):
                return low + at
    return None


def _candidates(window: memoryview, left: int, known: Array) -> list[int]:
    heads = heads_of(window)
    opcode, size = heads["opcode"], heads["size"]
    likely = np.isin(opcode, (SCHEMA, CHANNEL, CHUNK, DATA_END)) | (opcode == MESSAGE) & (size >= _SHORTEST)
    where = np.flatnonzero(likely & (size >= 0) & (size < left))
    return [int(at) for at in where[(opcode[where] != MESSAGE) | known[heads["channel"][where]]]]


def _convincing(data: memoryview, at: int, end: int) -> bool:
    """Whether a whole record is at `at` and either it is a chunk that adds up or another record follows it."""
    if not _plausible(data, at, end):
        return False
    opcode, length = HEAD.unpack_from(data, at)
    after = at + HEAD.size + length
    if opcode == CHUNK:
        *_, compression, packed = chunk_head(data, at)
        return compression in NAMES and length == _CHUNK_FIXED + len(compression) + len(packed)
    return after == end or (_plausible(data, after, end) and data[after] in FIELDS)

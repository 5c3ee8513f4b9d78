"""Read ROS 1 bags (format 2.0) as undecoded batches; only what requested topics need is read."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ...errors import FormatError
from ..diagnostics import Diagnostics
from ..limits import LIMITS, Input
from ..mapped_log import MappedLog
from ..records import Array, Batch, Topic
from ..storage.compression import STORED, Buffer
from ..storage.mmapped import drop_pages
from ..topics import TopicTable, log_time_span, split_by_topic_id
from .chunks import BagChunk, BagMessages, BagRun, list_bag_messages, load_bag_chunk, scan_messages
from .records import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    MAGIC,
    MESSAGE,
    BagRecord,
    fields_of,
    iterate_bag_records,
    record_at,
)
from .truncated import cut_at, decompress_truncated


@dataclass
class BagSurvey:
    """Connections by id, counts by id, parts in file order, log times (ns)."""

    connections: dict[int, dict[bytes, bytes]] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    parts: list[BagChunk | BagRun] = field(default_factory=list)
    times: list[int] = field(default_factory=list)

    def declare(self, record: BagRecord, data: memoryview) -> None:
        """Add a connection; the first one of an id is kept."""
        fields = {**fields_of(data, record.body, record.end), **record.fields}
        self.connections.setdefault(
            record.number(b"conn"), {name: bytes(value) for name, value in fields.items()}
        )

    def count(self, connections: Array, log_ns: Array) -> None:
        """Count messages by connection (n,) and log time (n,) ns."""
        if len(connections):
            for connection, number in zip(*np.unique(connections, return_counts=True), strict=True):
                self.counts[int(connection)] = self.counts.get(int(connection), 0) + int(number)
            self.times += [int(log_ns.min()), int(log_ns.max())]


class BagLog(MappedLog):
    """One memory-mapped ROS 1 bag; see protocol.Log."""

    format = "bag"

    def __init__(
        self, path: Path, strict: bool = False, source: Path | None = None, limits: Input = LIMITS
    ) -> None:
        """Map `source` (default: `path`) and survey it; LogError if strict and data is lost."""
        super().__init__(path, strict, source, limits)
        self._survey = survey_bag(self._data, self._diagnostics)
        self.topics, self._topic_of = _bag_topics(self._survey)
        self.start_ns, self.end_ns = log_time_span(self._survey.times, self._diagnostics)

    def batches(self, ids: Collection[int] | None = None) -> Iterator[Batch]:
        """Messages of the topics `ids` (None: all) in
        file order, one batch per topic and chunk or run.
        """
        wanted = {c: t for c, t in self._topic_of.items() if ids is None or t in ids}
        buffer = Buffer(self.path, self._diagnostics.limits)
        for part in self._survey.parts:
            if isinstance(part, BagRun):
                whole = np.frombuffer(self._data, np.uint8)
                yield from _split_bag_messages(
                    whole,
                    scan_messages(self._data, part.start, part.end, part.start, self._diagnostics),
                    wanted,
                )
            elif not part.counts or wanted.keys() & part.counts.keys():
                loaded = load_bag_chunk(self._data, part, buffer, self._diagnostics)
                if loaded is not None:
                    content, indexes = loaded
                    yield from _split_bag_messages(
                        content,
                        list_bag_messages(
                            content, self._data, part.start, indexes, self._diagnostics
                        ),
                        wanted,
                    )
                    drop_pages(self._data, part.start, part.start + len(content))

    def spans(self) -> dict[int, tuple[int, int]]:
        """Empty: a bag's indexes give the times of chunks, not of topics."""
        return {}


def _bag_topics(survey: BagSurvey) -> tuple[tuple[Topic, ...], dict[int, int]]:
    topics = TopicTable()
    topic_of = {}
    for connection, fields in survey.connections.items():
        text = {
            name.decode(errors="replace"): value.decode(errors="replace")
            for name, value in fields.items()
        }
        kept = {
            name: value
            for name, value in text.items()
            if name in ("md5sum", "callerid", "latching")
        }
        definition = fields.get(b"message_definition", b"")
        name = text.get("topic", "")
        kind = text.get("type", "")
        count = survey.counts.get(connection, 0)
        topic_of[connection] = topics.add(name, kind, "ros1", definition, "ros1msg", count, kept)
    return topics.all(), topic_of


def _split_bag_messages(
    content: Array, found: BagMessages, wanted: dict[int, int]
) -> Iterator[Batch]:
    known, where = np.unique(found.connection, return_inverse=True)
    topic = np.array([wanted.get(int(one), -1) for one in known], np.int64)[where]
    return split_by_topic_id(topic, found.log_ns, content, found.offset, found.length)


def survey_bag(data: memoryview, diagnostics: Diagnostics) -> BagSurvey:
    """Survey the bag; damage and contradictions go to the diagnostics."""
    survey = None
    try:
        survey = _survey_by_index(data, diagnostics)
    except FormatError as problem:
        diagnostics.warn(f"the bag's index is not used: {problem}")
    if survey is None:
        survey = BagSurvey()
        _scan_bag_records(data, survey, diagnostics)
    for connection in survey.counts.keys() - survey.connections.keys():
        why = f"no record declares connection {connection}"
        diagnostics.add_loss(-connection - 1, 0, survey.counts[connection], None, why)
    return survey


def _survey_by_index(data: memoryview, diagnostics: Diagnostics) -> BagSurvey | None:
    header = record_at(data, len(MAGIC), len(data))
    at = header.number(b"index_pos", 8)
    if header.op != BAG_HEADER or at == 0:
        diagnostics.warn(
            "the bag was never closed: it has no index; its records were read one by one"
        )
        return None
    if not header.end <= at <= len(data):
        raise FormatError(f"it is declared to start at byte {at} of {len(data)}")
    survey = BagSurvey()
    while at < len(data):
        record = record_at(data, at, len(data))
        if record.op == CONNECTION:
            survey.declare(record, data)
        elif record.op == CHUNK_INFO:
            _announce_connection(data, record, survey)
        at = record.end
    declared = header.number(b"conn_count"), header.number(b"chunk_count")
    if declared != (len(survey.connections), len(survey.parts)):
        raise FormatError(
            f"{declared[0]} connections and {declared[1]} chunks are declared, "
            f"{len(survey.connections)} and {len(survey.parts)} listed"
        )
    survey.parts.sort(key=lambda part: part.start)
    return survey


def _announce_connection(data: memoryview, record: BagRecord, survey: BagSurvey) -> None:
    count = record.number(b"count")
    if record.size < 8 * count:
        raise FormatError(f"byte {record.start}: {record.size} bytes for {count} connections")
    pairs = np.frombuffer(data, "<u4", 2 * count, record.body).reshape(-1, 2).tolist()
    survey.parts.append(BagChunk(record.number(b"chunk_pos", 8), dict(pairs)))
    for connection, number in pairs:
        survey.counts[connection] = survey.counts.get(connection, 0) + number
    if count:
        survey.times += [record.time_ns(b"start_time"), record.time_ns(b"end_time")]


def _scan_bag_records(data: memoryview, survey: BagSurvey, diagnostics: Diagnostics) -> None:
    """Survey all records; chunks are opened for the connections and messages inside."""

    def lost(at: int, size: int) -> None:
        diagnostics.add_loss(at, size, None, None, "no whole record can be read there")

    def cut(at: int) -> int | None:
        return _survey_truncated_chunk(data, at, survey, diagnostics)

    buffer = Buffer(diagnostics.path, diagnostics.limits)
    for record in iterate_bag_records(data, len(MAGIC), len(data), lost, cut):
        try:
            if record.op == CONNECTION:
                survey.declare(record, data)
            elif record.op == CHUNK:
                _survey_chunk_content(data, BagChunk(record.start, {}), survey, buffer, diagnostics)
            elif record.op == MESSAGE:
                _survey_loose_record(record, survey)
        except FormatError:
            lost(record.start, record.end - record.start)


def _survey_truncated_chunk(
    data: memoryview, at: int, survey: BagSurvey, diagnostics: Diagnostics
) -> int | None:
    """Survey the rest of a truncated chunk at byte `at`;
    returns the byte after it, or after an uncompressed head.

    None if there is no such chunk, or no message of it can be decompressed.
    """
    found = cut_at(data, at)
    if found is None:
        return None
    why = (
        f"the file ends in this chunk, after {len(data) - at} bytes, which are read as far as they "
    )
    if found.compression in STORED:
        diagnostics.add_loss(at, found.lacks, None, None, why + "go")
        return len(data) - len(found.packed)
    content = decompress_truncated(found)
    if not len(scan_messages(memoryview(content), 0, len(content), at, Diagnostics(Path())).starts):
        return None
    diagnostics.add_loss(at, None, None, None, why + "unpack")
    _survey_chunk_content(
        data,
        BagChunk(at, {}, cut=True),
        survey,
        Buffer(diagnostics.path, diagnostics.limits),
        diagnostics,
    )
    return len(data)


def _survey_chunk_content(
    data: memoryview, chunk: BagChunk, survey: BagSurvey, buffer: Buffer, diagnostics: Diagnostics
) -> None:
    loaded = load_bag_chunk(data, chunk, buffer, diagnostics)
    if loaded is None:
        return
    content, indexes = loaded
    for inner in iterate_bag_records(content.data, 0, len(content), lambda _at, _size: None):
        if inner.op == CONNECTION:
            survey.declare(inner, content.data)
    found = list_bag_messages(content, data, chunk.start, indexes, diagnostics)
    survey.count(found.connection, found.log_ns)
    survey.parts.append(
        replace(chunk, counts=dict.fromkeys(np.unique(found.connection).tolist(), 0))
    )


def _survey_loose_record(record: BagRecord, survey: BagSurvey) -> None:
    connection = record.number(b"conn")
    log_ns = record.time_ns(b"time")
    survey.count(np.array([connection]), np.array([log_ns]))
    last = survey.parts[-1] if survey.parts else None
    if isinstance(last, BagRun) and last.end == record.start:
        survey.parts[-1] = BagRun(last.start, record.end)
    else:
        survey.parts.append(BagRun(record.start, record.end))

"""ROS 1 bags (format 2.0) -> undecoded batches: by their index, or by their records when it is missing or damaged."""

import mmap
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import FormatError
from ..types import Array, Batch, Finding, Topic
from .bag_records import CHUNK, INDEX, MESSAGE, BagRecord, fields_of, record_at, sound_records
from .compression import Buffer
from .ledger import Ledger
from .topics import Topics, split


class Index(NamedTuple):
    """Where one connection's messages in a chunk are listed: byte of the list, number of entries."""

    at: int
    count: int


@dataclass(frozen=True)
class BagChunk:
    """One chunk: byte of its record, and {connection: messages in it}, empty when unknown."""

    start: int
    counts: dict[int, int]


class BagRun(NamedTuple):
    """A run of message records outside chunks."""

    start: int
    end: int


@dataclass
class BagSurvey:
    """What a bag holds: connections by id, counts by id, parts in file order, log times (ns)."""

    connections: dict[int, dict[bytes, bytes]] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    parts: list[BagChunk | BagRun] = field(default_factory=list)
    times: list[int] = field(default_factory=list)

    def declare(self, record: BagRecord, data: memoryview) -> None:
        """Take in a connection; the first one of an id stands."""
        said = {**fields_of(data, record.body, record.end), **record.fields}
        self.connections.setdefault(record.number(b"conn"), {name: bytes(value) for name, value in said.items()})

    def count(self, connections: Array, log_ns: Array) -> None:
        """Take in messages by their connections (n,) and log times (n,) ns."""
        if len(connections):
            for connection, number in zip(*np.unique(connections, return_counts=True), strict=True):
                self.counts[int(connection)] = self.counts.get(int(connection), 0) + int(number)
            self.times += [int(log_ns.min()), int(log_ns.max())]


class Messages(NamedTuple):
    """Messages inside a chunk, in its order: connection, log time (ns), and where each payload is; all (n,)."""

    connection: Array
    log_ns: Array
    offset: Array
    length: Array
    starts: Array


class BagLog:
    """One ROS 1 bag, memory-mapped; see containers.Log."""

    format = "bag"

    def __init__(self, path: Path, strict: bool = False, source: Path | None = None) -> None:
        """Map `source` (default: `path` itself) and survey it; LogError when strict and something is lost."""
        from .bag_salvage import survey_of

        self.path = path
        self._ledger = Ledger(path, strict)
        with (source or path).open("rb") as stream:
            self._data = memoryview(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ))
        self._survey = survey_of(self._data, self._ledger)
        self.topics, self._topic_of = _topics(self._survey)
        self.start_ns = min(self._survey.times, default=0)
        self.end_ns = max(self._survey.times, default=0)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was found wrong so far; reading on may add to it."""
        return self._ledger.findings

    def batches(self, ids: Collection[int] | None = None) -> Iterator[Batch]:
        """Messages of the topics `ids` (None: all) in file order, one batch per topic and chunk or run."""
        wanted = {c: t for c, t in self._topic_of.items() if ids is None or t in ids}
        buffer = Buffer()
        for part in self._survey.parts:
            if isinstance(part, BagRun):
                whole = np.frombuffer(self._data, np.uint8)
                yield from _split(whole, walked(self._data, part.start, part.end, part.start, self._ledger), wanted)
            elif not part.counts or wanted.keys() & part.counts.keys():
                loaded = load(self._data, part, buffer, self._ledger)
                if loaded is not None:
                    content, indexes = loaded
                    yield from _split(content, messages(content, self._data, part.start, indexes, self._ledger), wanted)

    def close(self) -> None:
        """Let go of the file; batches still held keep their bytes."""
        self._data = memoryview(b"")

    def __enter__(self) -> "BagLog":
        """The log itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()


def _topics(survey: BagSurvey) -> tuple[tuple[Topic, ...], dict[int, int]]:
    topics, topic_of = Topics(), {}
    for connection, said in survey.connections.items():
        text = {name.decode(errors="replace"): value.decode(errors="replace") for name, value in said.items()}
        kept = {name: text[name] for name in ("md5sum", "callerid", "latching") if name in text}
        definition = said.get(b"message_definition", b"")
        topic_of[connection] = topics.add(
            text.get("topic", ""), text.get("type", ""), "ros1", definition, "ros1msg", survey.counts.get(connection, 0), kept
        )
    return topics.all(), topic_of


def load(data: memoryview, chunk: BagChunk, buffer: Buffer, ledger: Ledger) -> tuple[Array, dict[int, Index]] | None:
    """The chunk's records (bytes,) uint8 and the lists of messages behind it; None and a loss when it is damaged."""
    size = 0
    try:
        record = record_at(data, chunk.start, len(data))
        size = record.end - chunk.start
        if record.op != CHUNK:
            raise FormatError(f"byte {chunk.start}: op {record.op} where a chunk was announced")
        compression = str(record.fields.get(b"compression", b""), "ascii", "replace")
        packed = data[record.body : record.end]
        return buffer.load(compression, packed, record.number(b"size")), indexes_at(data, record.end)
    except FormatError as problem:
        ledger.lost(chunk.start, size, sum(chunk.counts.values()) or None, None, str(problem))
        return None


def indexes_at(data: memoryview, at: int) -> dict[int, Index]:
    """{connection: its list of messages} from the index records at byte `at`."""
    indexes: dict[int, Index] = {}
    while at < len(data):
        try:
            record = record_at(data, at, len(data))
            if record.op != INDEX or record.number(b"count") * 12 > record.size:
                return indexes
            indexes[record.number(b"conn")] = Index(record.body, record.number(b"count"))
        except FormatError:
            return indexes
        at = record.end
    return indexes


def messages(
    content: Array, data: memoryview, place: int, indexes: dict[int, Index], ledger: Ledger
) -> Messages:
    """All messages of a loaded chunk in its own order: by its indexes where they are right, else by walking."""
    found = _indexed(content, data, indexes) if indexes else None
    if found is None:
        if indexes:
            ledger.warn(f"the index of the chunk at byte {place} is wrong; its records were walked")
        return walked(content.data, 0, len(content), place, ledger)
    return found


def _slide(content: Array, width: int) -> Array:
    """A view (n, width) whose row i are the bytes from byte i."""
    rows = max(0, len(content) - width + 1)
    return np.ndarray((rows, width), np.uint8, content, 0, (1, 1))


def _u32(content: Array, at: Array) -> Array:
    return _slide(content, 4)[at].view("<u4")[:, 0].astype(np.int64)


def _indexed(content: Array, data: memoryview, indexes: dict[int, Index]) -> Messages | None:
    lists = [np.frombuffer(data, "<u4", 3 * count, at)[2::3].astype(np.int64) for at, count in indexes.values()]
    starts = np.concatenate(lists)
    listed = np.repeat(np.array(list(indexes), np.int64), [len(part) for part in lists])
    if not len(starts) or starts.max() > len(content) - 8:
        return None
    order = np.argsort(starts, kind="stable")
    starts, listed = starts[order], listed[order]
    header = _u32(content, starts)
    offset = starts + 8 + header
    if offset.max() > len(content):
        return None
    length = _u32(content, offset - 4)
    if not _tiled(content, starts, offset + length):
        return None
    connection, log_ns = np.empty_like(starts), np.empty_like(starts)
    for size in np.unique(header).tolist():
        rows = np.flatnonzero(header == size)
        said = _alike(content, starts[rows] + 4, size)
        if said is None:
            return None
        connection[rows], log_ns[rows] = said
    return Messages(connection, log_ns, offset, length, starts) if (connection == listed).all() else None


def _alike(content: Array, at: Array, size: int) -> tuple[Array, Array] | None:
    """Connection and time of message headers that differ in nothing else; None when they do."""
    headers = _slide(content, size)[at]
    first = memoryview(headers[0].data)
    try:
        record = BagRecord(MESSAGE, fields_of(first, 0, size), 0, 0, 0)
        record.number(b"conn"), record.number(b"time", 8)
    except FormatError:
        return None
    if record.fields.get(b"op") != bytes([MESSAGE]):
        return None
    conn, time = (bytes(first).index(bytes([len(name) + width, 0, 0, 0]) + name) + 4 + len(name) for name, width in _VARY)
    same = np.ones(size, bool)
    same[conn : conn + 4] = same[time : time + 8] = False
    if (headers[:, same] != headers[0, same]).any():
        return None
    seconds = np.ascontiguousarray(headers[:, time : time + 8]).view("<u4").astype(np.int64)
    connection = np.ascontiguousarray(headers[:, conn : conn + 4]).view("<u4")[:, 0].astype(np.int64)
    return connection, seconds[:, 0] * 10**9 + seconds[:, 1]


_VARY = ((b"conn=", 4), (b"time=", 8))


def _tiled(content: Array, starts: Array, ends: Array) -> bool:
    """Whether nothing but other whole records lies between the messages: none is missing from the index."""
    lows, highs = np.concatenate(([0], ends)), np.concatenate((starts, [len(content)]))
    if (lows > highs).any():
        return False
    view = content.data
    try:
        for i in np.flatnonzero(lows < highs):
            at, end = int(lows[i]), int(highs[i])
            while at < end:
                record = record_at(view, at, end)
                if record.op == MESSAGE:
                    return False
                at = record.end
    except FormatError:
        return False
    return True


def walked(data: memoryview, start: int, end: int, place: int, ledger: Ledger) -> Messages:
    """The messages between two bytes of `data`, one record after another; losses are said to be at byte `place`."""

    def lost(at: int, size: int) -> None:
        ledger.lost(place, size, None, None, f"records inside the chunk are damaged from its byte {at}")

    rows = []
    for record in sound_records(data, start, end, lost):
        if record.op == MESSAGE:
            try:
                row = (record.number(b"conn"), record.time_ns(b"time"), record.body, record.size, record.start)
            except FormatError:
                lost(record.start, record.end - record.start)
                continue
            rows.append(row)
    return Messages(*np.array(rows, np.int64).reshape(-1, 5).T)


def _split(content: Array, found: Messages, wanted: dict[int, int]) -> Iterator[Batch]:
    known, where = np.unique(found.connection, return_inverse=True)
    topic = np.array([wanted.get(int(one), -1) for one in known], np.int64)[where]
    return split(topic, found.log_ns, content, found.offset, found.length)

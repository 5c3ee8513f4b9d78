"""rosbag2's SQLite files -> undecoded batches: read only, never a file written beside the user's."""

import shutil
import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote

import numpy as np

from ..errors import LogError
from ..types import Batch, Finding, Topic
from .ledger import Ledger
from .topics import Topics, normalised
from .unpacked import unpacked

_ROWS = 4096
_BYTES = 4 << 20
_LARGEST = 1 << 30

Row = tuple[int, int, int, bytes]
"""rowid, topic id in the file, log time (ns), payload."""


class Db3Log:
    """One .db3 file; see containers.Log."""

    format = "db3"

    def __init__(self, path: Path, strict: bool = False, source: Path | None = None) -> None:
        """Open `source` (default: `path` itself) read only; LogError when it has no topics or messages."""
        self.path = path
        self._ledger = Ledger(path, strict)
        self._store = _connect(path, source or path)
        try:
            self._size = (source or path).stat().st_size
            named = _topics(self._store)
            counts = self._counts()
        except sqlite3.Error as problem:
            self._store.close()
            raise LogError(f"{path}: not readable as a rosbag2 database: {problem}; type: bodylog doctor") from None
        topics, self._topic_of = Topics(), {}
        for number, (name, kind, encoding, definition, dialect, metadata) in named.items():
            count = counts.get(number, (0, 0, 0))[0]
            self._topic_of[number] = topics.add(name, kind, encoding, definition, dialect, count, metadata)
        self.topics: tuple[Topic, ...] = topics.all()
        self.start_ns = min((low for _, low, _ in counts.values()), default=0)
        self.end_ns = max((high for _, _, high in counts.values()), default=0)
        for number in counts.keys() - named.keys():
            self._ledger.lost(-number, None, counts[number][0], None, f"no row says what topic {number} is")

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was found wrong so far; reading on may add to it."""
        return self._ledger.findings

    def batches(self, ids: Collection[int] | None = None) -> Iterator[Batch]:
        """Messages of the topics `ids` (None: all) in the order stored, one batch per topic and block of rows."""
        wanted = {number: topic for number, topic in self._topic_of.items() if ids is None or topic in ids}
        if wanted:
            rows = self._rows(None if ids is None else wanted)
            found = (batch for block in rows for batch in _batches(block, wanted))
            yield from unpacked(found, self.topics, self._ledger)

    def close(self) -> None:
        """Let go of the file."""
        self._store.close()

    def __enter__(self) -> "Db3Log":
        """The log itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()

    def _counts(self) -> dict[int, tuple[int, int, int]]:
        """Topic id in the file -> messages, first and last log time (ns)."""
        query = "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages GROUP BY topic_id"
        try:
            found = self._store.execute(query).fetchall()
            if all(type(value) is int for row in found for value in row):
                return {topic: (count, low, high) for topic, count, low, high in found}
        except sqlite3.DatabaseError as problem:
            self._ledger.warn(f"the table of messages is damaged: {problem}")
        counts: dict[int, tuple[int, int, int]] = {}
        for block in self._rows(None):
            for _, topic, time, _ in block:
                count, low, high = counts.get(topic, (0, time, time))
                counts[topic] = (count + 1, min(low, time), max(high, time))
        return counts

    def _rows(self, wanted: Collection[int] | None) -> Iterator[list[Row]]:
        """The rows of these topics in blocks, in the order stored; what cannot be read is skipped and said."""
        chosen = "" if wanted is None else f" AND topic_id IN ({','.join(str(int(number)) for number in wanted)})"
        query = f"SELECT rowid, topic_id, timestamp, data FROM messages WHERE rowid > ?{chosen} ORDER BY rowid"
        last: Row | None = None
        low = -(1 << 63)
        while True:
            block: list[Row] = []
            size, after = 0, low
            try:
                for row in self._store.execute(query, (after,)):
                    low = row[0]
                    if type(row[3]) is not bytes or type(row[1]) is not int or type(row[2]) is not int:
                        self._ledger.lost(low, None, 1, None, f"row {low} of messages is damaged")
                        continue
                    block.append(row)
                    size += len(row[3])
                    last = row
                    if len(block) == _ROWS or size > _BYTES:
                        yield block
                        block, size = [], 0
            except sqlite3.DatabaseError as problem:
                failed: sqlite3.DatabaseError | None = problem
            else:
                failed = None
            if block:
                yield block
            following = self._next(low, last, failed) if failed else None
            if following is None:
                return
            low = following

    def _next(self, low: int, last: Row | None, problem: sqlite3.Error) -> int | None:
        """The rowid after which rows can be read again, or None; what lies between is lost."""
        base = max(low, 0)
        step = 1
        while step < 1 << 40 and not self._readable(base + step):
            step *= 2
        short, long = step // 2, step
        while long - short > 1:
            middle = (short + long) // 2
            short, long = (short, middle) if self._readable(base + middle) else (middle, long)
        row = self._first(base + long) if step < 1 << 40 else None
        rows = row[0] - base - 1 if row else None
        seconds = max(0, row[2] - last[2]) / 1e9 if row and last else None
        why = f"the rows after rowid {base} cannot be read: {problem}"
        self._ledger.lost(base, None, rows, seconds, why)
        return base + long if row else None

    def _readable(self, after: int) -> bool:
        try:
            self._first(after)
            return True
        except sqlite3.DatabaseError:
            return False

    def _first(self, after: int) -> Row | None:
        query = "SELECT rowid, topic_id, timestamp, data FROM messages WHERE rowid > ? ORDER BY rowid LIMIT 1"
        row: Row | None = self._store.execute(query, (after,)).fetchone()
        return row if row and type(row[2]) is int else None


def _connect(path: Path, source: Path) -> sqlite3.Connection:
    pending = [beside for end in ("-wal", "-journal") if (beside := source.with_name(source.name + end)).is_file()]
    if not any(beside.stat().st_size for beside in pending):
        return _opened(f"file:{quote(str(source.resolve()))}?mode=ro&immutable=1", source.stat().st_size)
    needed = sum(part.stat().st_size for part in (source, *pending))
    with TemporaryDirectory(prefix="bodylog-") as folder:
        if shutil.disk_usage(folder).free < 2 * needed:
            raise LogError(f"{path}: {pending[0].name} holds unsaved rows; {2 * needed} bytes are needed in {folder}")
        for part in (source, *pending):
            shutil.copyfile(part, Path(folder) / part.name)
        store = _opened(f"file:{quote(folder)}/{quote(source.name)}?mode=rw", 2 * needed)
        store.execute("SELECT count(*) FROM sqlite_master").fetchall()
        return store


def _opened(address: str, size: int) -> sqlite3.Connection:
    store = sqlite3.connect(address, uri=True, check_same_thread=False)
    store.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(1 << 16, min(_LARGEST, size)))
    store.text_factory = _text
    return store


def _text(raw: bytes) -> str:
    return raw.decode(errors="replace")


def _topics(store: sqlite3.Connection) -> dict[int, tuple[str, str, str, bytes, str, dict[str, str]]]:
    """Id in the file -> name, type, encoding, definition, its dialect, metadata."""
    columns = [row[1] for row in store.execute("PRAGMA table_info(topics)")]
    kept = [name for name in ("offered_qos_profiles", "type_description_hash") if name in columns]
    chosen = ", ".join(["id", "name", "type", "serialization_format", *kept])
    definitions = _definitions(store)
    topics = {}
    for number, name, kind, encoding, *rest in store.execute(f"SELECT {chosen} FROM topics"):
        metadata = {key: str(value) for key, value in zip(kept, rest, strict=True) if value}
        definition, dialect = definitions.get(kind) or _standard(normalised(str(kind)))
        topics[int(number)] = (str(name), str(kind), str(encoding or "cdr"), definition, dialect, metadata)
    return topics


def _definitions(store: sqlite3.Connection) -> dict[str, tuple[bytes, str]]:
    if not store.execute("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'").fetchall():
        return {}
    rows = store.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
    return {kind: (str(text).encode(), str(dialect)) for kind, dialect, text in rows if text}


def _standard(kind: str) -> tuple[bytes, str]:
    """The definition of a type every ROS 2 has, or nothing."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    if kind not in store.fielddefs:
        return b"", ""
    return store.generate_msgdef(kind, ros_version=2)[0].encode(), "ros2msg"


def _batches(block: list[Row], wanted: dict[int, int]) -> Iterator[Batch]:
    of_topic: dict[int, tuple[list[int], list[bytes]]] = {}
    for _, number, time, payload in block:
        if number in wanted:
            times, payloads = of_topic.setdefault(wanted[number], ([], []))
            times.append(time)
            payloads.append(payload)
    for topic, (times, payloads) in of_topic.items():
        length = np.fromiter(map(len, payloads), np.int64, len(payloads))
        data = np.frombuffer(b"".join(payloads), np.uint8)
        yield Batch(topic, np.array(times, np.int64), data, np.cumsum(length) - length, length)

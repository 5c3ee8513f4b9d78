"""Read rosbag2's SQLite files as undecoded batches:
read only, no file is written beside the user's.
"""

import os
import shutil
import sqlite3
import time
from array import array
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import numpy as np

from ...errors import LogError
from ...io.temporary import create_scratch_folder
from ..diagnostics import Diagnostics
from ..limits import LIMITS, Input
from ..records import Array, Batch, Finding, Topic
from ..storage.packed_files import decompress_messages
from ..topics import TopicTable, log_time_span, normalise_message_type, split_by_topic_id

_ENDS = ("min", "max")
_FEW_TOPICS = 8
_LARGEST = 1 << 30
_TABLES = ("topics", "messages", "message_definitions")
_STEPS = 1_000_000
"""SQLite's virtual machine steps, a few milliseconds, between checks for Python signals."""
DAMAGE = (sqlite3.Error, UnicodeError)
"""Exceptions of SQLite for a damaged file."""
_AGAIN = 0.5
_ROWS = 512
_FIRST_ROWS = 16
_BYTES = 16 << 20
_LOWEST = -(1 << 63)
_COLUMNS = "rowid, topic_id, timestamp, data"
_SELECT = "SELECT {} FROM messages WHERE rowid > ? {} ORDER BY rowid"
Row = tuple[int, int, int, bytes]
"""rowid, topic id in the file, log time (ns), payload."""


class Block(NamedTuple):
    """Rows as arrays: topic id in the file (n,), log time
    (n,) ns, bytes, offset and length of payloads (n,).
    """

    topic: Array
    log_ns: Array
    data: Array
    offset: Array
    length: Array


class MessageRows:
    """The table of messages; losses go to the diagnostics."""

    def __init__(self, store: sqlite3.Connection, diagnostics: Diagnostics) -> None:
        """For an open database."""
        self._store = store
        self._diagnostics = diagnostics

    def blocks(self, wanted: Collection[int] | None) -> Iterator[Block]:
        """The rows of these topics in the order stored;
        unreadable rows are skipped and recorded as losses.
        """
        chosen = (
            ""
            if wanted is None
            else f"AND topic_id IN ({','.join(str(int(number)) for number in wanted)})"
        )
        count = _FIRST_ROWS
        largest = 1
        low = _LOWEST
        try:
            cursor = self._store.execute(_SELECT.format(_COLUMNS, chosen), (low,))
            while rows := cursor.fetchmany(count):
                block = _rows_to_block(rows, low)
                if block is None:
                    break
                yield block
                low = rows[-1][0]
                largest = max(largest, int(block.length.max()))
                count = max(1, min(_ROWS, _BYTES // largest))
            else:
                return
        except DAMAGE as problem:
            raise_if_interrupted(problem)  # else continue row by row, past the damage
        yield from self._damaged_rows(chosen, wanted, low)

    def _damaged_rows(
        self, chosen: str, wanted: Collection[int] | None, low: int
    ) -> Iterator[Block]:
        """The sound rows after rowid `low`, one to a block."""
        query = _SELECT.format(_COLUMNS, chosen)
        last_ns: int | None = None
        while True:
            try:
                for row in self._store.execute(query, (low,)):
                    _require_rising_rowid(row, low)
                    yield from self._one(row, low)
                    low = row[0]
                    last_ns = row[2]
                return
            except DAMAGE as problem:
                raise_if_interrupted(problem)
                found = self._next(low, last_ns, problem)
            if found is None:
                return
            if wanted is None or found[1] in wanted:
                yield from self._one(found, low)
            low = found[0]

    def _one(self, row: Row, low: int) -> Iterator[Block]:
        block = _rows_to_block([row], low)
        if block is not None:
            yield block
        else:
            self._diagnostics.add_loss(
                row[0], None, 1, None, f"row {row[0]} of messages is damaged"
            )

    def _next(self, low: int, last_ns: int | None, problem: Exception) -> Row | None:
        """The next readable row after rowid `low`, or None; records the rows between as lost."""
        base = max(low, 0)
        step = 0
        while step < 1 << 40 and not self._readable(base + step):
            step = max(1, 2 * step)
        short = step // 2
        long = step
        while long - short > 1:
            middle = (short + long) // 2
            short, long = (short, middle) if self._readable(base + middle) else (middle, long)
        row = self._first(base + long) if step < 1 << 40 else None
        if row is None or row[0] > base + 1:
            rows = row[0] - base - 1 if row else None
            seconds = max(0, row[2] - last_ns) / 1e9 if row and last_ns is not None else None
            self._diagnostics.add_loss(
                base, None, rows, seconds, f"the rows after rowid {base} cannot be read: {problem}"
            )
        return row

    def _readable(self, after: int) -> bool:
        try:
            self._first(after)
            return True
        except DAMAGE as problem:
            raise_if_interrupted(problem)
            return False

    def _first(self, after: int) -> Row | None:
        query = _SELECT.format(_COLUMNS, "") + " LIMIT 1"
        row: Row | None = self._store.execute(query, (after,)).fetchone()
        if row:
            _require_rising_rowid(row, after)
        return row if row and type(row[2]) is int else None


class Db3Log:
    """One .db3 file; see protocol.Log."""

    format = "db3"

    def __init__(
        self, path: Path, strict: bool = False, source: Path | None = None, limits: Input = LIMITS
    ) -> None:
        """Open `source` (default: `path`) read only; LogError when it has no topics or messages."""
        self.path = path
        self._diagnostics = Diagnostics(path, strict, limits)
        self._store = _connect_database(path, source or path)
        try:
            _only_tables(path, self._store)
            self._rows = MessageRows(self._store, self._diagnostics)
            named = _read_topic_rows(self._store)
            counts, *ends = self._survey(list(named))
        except LogError:
            self._store.close()
            raise
        except DAMAGE as problem:
            self._store.close()
            raise_if_interrupted(problem)
            advice = f"type: sqlite3 {path} .recover | sqlite3 whole.db3"
            raise LogError(
                f"{path}: not readable as a rosbag2 database: {problem}; {advice}"
            ) from None
        self.start_ns, self.end_ns = log_time_span(ends if counts else (), self._diagnostics)
        topics = TopicTable()
        self._topic_of = {}
        for number, (name, kind, encoding, definition, dialect, metadata) in named.items():
            count = counts.get(number, 0)
            self._topic_of[number] = topics.add(
                name, kind, encoding, definition, dialect, count, metadata
            )
        self.topics: tuple[Topic, ...] = topics.all()
        for number in counts.keys() - named.keys():
            self._diagnostics.add_loss(
                -number, None, counts[number], None, f"no row declares topic {number}"
            )

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Problems found so far; further reading may add to them."""
        return self._diagnostics.findings

    def batches(self, ids: Collection[int] | None = None) -> Iterator[Batch]:
        """Messages of the topics `ids` (None: all) in the
        order stored, one batch per topic and block of rows.
        """
        wanted = {
            number: topic for number, topic in self._topic_of.items() if ids is None or topic in ids
        }
        if wanted:
            blocks = self._rows.blocks(None if ids is None else wanted)
            found = (batch for block in blocks for batch in _batches_by_topic(block, wanted))
            yield from decompress_messages(found, self.topics, self._diagnostics)

    def spans(self) -> dict[int, tuple[int, int]]:
        """Empty: times per topic would take a pass over all rows."""
        return {}

    def close(self) -> None:
        """Close the file."""
        self._store.close()

    def __enter__(self) -> "Db3Log":
        """Return the log."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self.close()

    def _survey(self, numbers: list[int]) -> tuple[dict[int, int], int, int]:
        """Messages by topic id in the file, first and last log time (ns)."""
        try:
            counts = self._counts(numbers)
            if self._store.execute("PRAGMA index_list(messages)").fetchall():
                # two look-ups instead of a scan
                times = [
                    self._store.execute(f"SELECT {end}(timestamp) FROM messages").fetchone()[0]
                    for end in _ENDS
                ]
            else:
                times = self._store.execute(
                    "SELECT min(timestamp), max(timestamp) FROM messages"
                ).fetchone()
            if all(type(value) is int for value in (*counts, *(times if counts else ()))):
                return counts, times[0] or 0, times[1] or 0
        except DAMAGE as problem:
            raise_if_interrupted(problem)
            self._diagnostics.warn(f"the table of messages is damaged: {problem}")
        counts = {}
        ends = []
        for block in self._rows.blocks(None):
            for topic in block.topic.tolist():
                counts[topic] = counts.get(topic, 0) + 1
            ends += [int(block.log_ns.min()), int(block.log_ns.max())]
        return counts, min(ends, default=0), max(ends, default=0)

    def _counts(self, numbers: list[int]) -> dict[int, int]:
        """Messages by topic id in the file; sums are twice as fast as grouping for few topics."""
        if 0 < len(numbers) <= _FEW_TOPICS:
            sums = ", ".join(f"sum(topic_id = {number})" for number in numbers)
            whole, *each = self._store.execute(f"SELECT count(*), {sums} FROM messages").fetchone()
            if whole == sum(count or 0 for count in each):
                return {number: count for number, count in zip(numbers, each, strict=True) if count}
        return dict(
            self._store.execute(
                "SELECT topic_id, count(*) FROM messages GROUP BY topic_id"
            ).fetchall()
        )


def _connect_database(path: Path, source: Path) -> sqlite3.Connection:
    """The database; rows that its write-ahead log or journal holds are read from a copy."""
    pending = [
        beside
        for end in ("-wal", "-journal")
        if (beside := source.with_name(source.name + end)).is_file()
    ]
    if not any(beside.stat().st_size for beside in pending):
        address = f"file:{quote(os.fsencode(source.resolve()))}?mode=ro&immutable=1"
        return _open_read_only(address, source.stat().st_size)
    needed = sum(part.stat().st_size for part in (source, *pending))
    with create_scratch_folder() as folder:
        if shutil.disk_usage(folder).free < 2 * needed:
            raise LogError(
                f"{path}: {pending[0].name} holds unsaved rows; {2 * needed} bytes are "
                f"needed in {folder}"
            )
        for part in (source, *pending):
            shutil.copyfile(part, folder / part.name)
        store = _open_read_only(
            f"file:{quote(os.fsencode(folder))}/{quote(os.fsencode(source.name))}?mode=rw",
            2 * needed,
        )
        store.execute("SELECT count(*) FROM sqlite_master").fetchall()
        return store


def _open_read_only(address: str, size: int) -> sqlite3.Connection:
    store = sqlite3.connect(address, uri=True, check_same_thread=False)
    store.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(1 << 16, min(_LARGEST, size)))
    store.text_factory = _decode_text
    store.execute("PRAGMA trusted_schema = OFF")
    store.set_progress_handler(lambda: 0, _STEPS)
    return store


def _only_tables(path: Path, store: sqlite3.Connection) -> None:
    """LogError for computed rows: a view, which may
    never end, a virtual table or a generated column.
    """
    for name in _TABLES:
        found = store.execute(
            "SELECT type, rootpage FROM sqlite_master WHERE lower(name) = ?", (name,)
        ).fetchall()
        kinds = [kind if kind != "table" or page else "virtual table" for kind, page in found]
        if any(kind != "table" for kind in kinds):
            raise LogError(
                f"{path}: {name} is a {kinds[0]}, where rosbag2 keeps a table; record the log again"
            )
        hidden = [row[1] for row in store.execute(f"PRAGMA table_xinfo({name})") if row[6]]
        if hidden:
            raise LogError(
                f"{path}: {name}.{hidden[0]} is computed, where rosbag2 stores values; "
                "record the log again"
            )


def _decode_text(raw: bytes) -> str:
    return raw.decode(errors="replace")


def _read_topic_rows(
    store: sqlite3.Connection,
) -> dict[int, tuple[str, str, str, bytes, str, dict[str, str]]]:
    """Id in the file -> name, type, encoding, definition, its dialect, metadata."""
    columns = [row[1] for row in store.execute("PRAGMA table_info(topics)")]
    kept = [name for name in ("offered_qos_profiles", "type_description_hash") if name in columns]
    chosen = ", ".join(["id", "name", "type", "serialization_format", *kept])
    definitions = _read_definitions(store)
    topics = {}
    for number, name, kind, encoding, *rest in store.execute(f"SELECT {chosen} FROM topics"):
        if type(number) is not int:
            continue  # a damaged row; its messages are reported as of an unknown topic
        metadata = {key: str(value) for key, value in zip(kept, rest, strict=True) if value}
        definition, dialect = definitions.get(kind) or _standard_definition(
            normalise_message_type(str(kind))
        )
        topics[number] = (
            str(name),
            str(kind),
            str(encoding or "cdr"),
            definition,
            dialect,
            metadata,
        )
    return topics


def _read_definitions(store: sqlite3.Connection) -> dict[str, tuple[bytes, str]]:
    if not store.execute(
        "SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'"
    ).fetchall():
        return {}
    rows = store.execute(
        "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
    )
    return {kind: (str(text).encode(), str(dialect)) for kind, dialect, text in rows if text}


def _standard_definition(kind: str) -> tuple[bytes, str]:
    """The definition of a type every ROS 2 has, or nothing."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    if kind not in store.fielddefs:
        return b"", ""
    return store.generate_msgdef(kind, ros_version=2)[0].encode(), "ros2msg"


def _batches_by_topic(block: Block, wanted: dict[int, int]) -> Iterator[Batch]:
    numbers = np.unique(block.topic)
    topic = np.array([wanted.get(number, -1) for number in numbers.tolist()], np.int64)
    topic = topic[np.searchsorted(numbers, block.topic)]
    return split_by_topic_id(topic, block.log_ns, block.data, block.offset, block.length)


def raise_if_interrupted(problem: Exception) -> None:
    """Raise KeyboardInterrupt if a signal, not damage,
    ended a query: SQLite hides exceptions of its handler.

    Other signals arrive again shortly and then end the process.
    """
    if getattr(problem, "sqlite_errorcode", None) == sqlite3.SQLITE_INTERRUPT:
        time.sleep(_AGAIN)
        raise KeyboardInterrupt


def _require_rising_rowid(row: Row, low: int) -> None:
    """DatabaseError when a row does not come after rowid
    `low`: pages that point back would be read forever.
    """
    if row[0] <= low:
        raise sqlite3.DatabaseError(f"row {row[0]} comes after row {low}")


def _rows_to_block(rows: list[Row], low: int) -> Block | None:
    """The rows as arrays; None if a value has the wrong type or rowids do not rise from `low`."""
    ids, numbers, times, payloads = zip(*rows, strict=True)
    try:
        rowid, topic, log_ns = (
            np.frombuffer(array("q", values), np.int64) for values in (ids, numbers, times)
        )
        data = np.frombuffer(b"".join(payloads), np.uint8)
    except TypeError:
        return None
    if rowid[0] <= low or (rowid[1:] <= rowid[:-1]).any():
        return None
    length = np.fromiter(map(len, payloads), np.int64, len(payloads))
    return Block(topic, log_ns, data, np.cumsum(length) - length, length)

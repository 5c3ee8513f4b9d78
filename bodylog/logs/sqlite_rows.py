"""The rows of a rosbag2 database as arrays, in the order stored, read on past what is damaged."""

import sqlite3
from array import array
from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np

from ..types import Array
from .ledger import Ledger

DAMAGE = (sqlite3.Error, UnicodeError)
"""What SQLite raises for a file that is damaged."""

_ROWS = 512
_FIRST_ROWS = 16
_BYTES = 16 << 20
_LOWEST = -(1 << 63)
_SELECT = "SELECT {} FROM messages WHERE rowid > ? {} ORDER BY rowid"

Row = tuple[int, int, int, bytes]
"""rowid, topic id in the file, log time (ns), payload."""


class Block(NamedTuple):
    """Rows as arrays: topic id in the file (n,), log time (n,) ns, all payloads one after another, lengths (n,)."""

    topic: Array
    log_ns: Array
    data: Array
    length: Array


class Rows:
    """The table of messages; what of it is lost goes into the ledger."""

    def __init__(self, store: sqlite3.Connection, ledger: Ledger) -> None:
        """Of an open database."""
        self._store, self._ledger = store, ledger

    def blocks(self, wanted: Collection[int] | None) -> Iterator[Block]:
        """The rows of these topics in the order stored; what cannot be read is skipped and said."""
        chosen = "" if wanted is None else f"AND topic_id IN ({','.join(str(int(number)) for number in wanted)})"
        count, largest, done = _FIRST_ROWS, 1, 0
        try:
            cursor = self._store.execute(_SELECT.format("topic_id, timestamp, data", chosen), (_LOWEST,))
            while rows := cursor.fetchmany(count):
                block = _block(rows)
                if block is None:
                    break
                yield block
                done += len(rows)
                largest = max(largest, int(block.length.max()))
                count = max(1, min(_ROWS, _BYTES // largest))
            else:
                return
        except DAMAGE:
            pass  # read on row by row, and past the damage
        yield from self._damaged_rows(chosen, self._rowid(chosen, done))

    def _rowid(self, chosen: str, done: int) -> int:
        """The rowid of the last of the `done` rows that were read."""
        query = _SELECT.format("rowid", chosen) + " LIMIT 1 OFFSET ?"
        return int(self._store.execute(query, (_LOWEST, done - 1)).fetchone()[0]) if done else _LOWEST

    def _damaged_rows(self, chosen: str, low: int) -> Iterator[Block]:
        """The sound rows after rowid `low`, one to a block."""
        last: Row | None = None
        query = _SELECT.format("rowid, topic_id, timestamp, data", chosen)
        while True:
            try:
                for row in self._store.execute(query, (low,)):
                    low, block = row[0], _block([row[1:]])
                    if block is not None:
                        last = row
                        yield block
                    else:
                        self._ledger.lost(low, None, 1, None, f"row {low} of messages is damaged")
                return
            except DAMAGE as problem:
                following = self._next(low, last, problem)
            if following is None:
                return
            low = following

    def _next(self, low: int, last: Row | None, problem: Exception) -> int | None:
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
        except DAMAGE:
            return False

    def _first(self, after: int) -> Row | None:
        query = _SELECT.format("rowid, topic_id, timestamp, data", "") + " LIMIT 1"
        row: Row | None = self._store.execute(query, (after,)).fetchone()
        return row if row and type(row[2]) is int else None


def _block(rows: list[tuple[int, int, bytes]]) -> Block | None:
    """The rows as arrays, or None when a value is not of the type its column must have."""
    numbers, times, payloads = zip(*rows, strict=True)
    try:
        topic, log_ns = (np.frombuffer(array("q", values), np.int64) for values in (numbers, times))
        data = np.frombuffer(b"".join(payloads), np.uint8)
    except TypeError:
        return None
    return Block(topic, log_ns, data, np.fromiter(map(len, payloads), np.int64, len(payloads)))

"""Read the rows of a rosbag2 database as arrays, in the order stored, past damaged ones."""

import sqlite3
import time
from array import array
from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np

from ..diagnostics import Diagnostics
from ..records import Array

DAMAGE = (sqlite3.Error, UnicodeError)
"""Exceptions of SQLite for a damaged file."""

_AGAIN = 0.5
_ROWS = 512
_FIRST_ROWS = 16
_BYTES = 16 << 20
_LOWEST = -(1 << 63)
_COLUMNS = "rowid, topic_id, timestamp, data"
_SELECT = "SELECT {} FROM messages WHERE rowid > ? {} ORDER BY rowid"


def raise_if_interrupted(problem: Exception) -> None:
    """Raise KeyboardInterrupt if a signal, not damage,
    ended a query: SQLite hides exceptions of its handler.

    Other signals arrive again shortly and then end the process.
    """
    if getattr(problem, "sqlite_errorcode", None) == sqlite3.SQLITE_INTERRUPT:
        time.sleep(_AGAIN)
        raise KeyboardInterrupt


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
                    low, last_ns = row[0], row[2]
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


def _require_rising_rowid(row: Row, low: int) -> None:
    """DatabaseError when a row does not come after rowid
    `low`: pages that point back would be read forever.
    """
    if row[0] <= low:
        raise sqlite3.DatabaseError(f"row {row[0]} comes after row {low}")


def _rows_to_block(rows: list[Row], low: int) -> Block | None:
    """The rows as arrays; None when a value has the
    wrong type, or rowids do not rise from `low`.
    """
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

"""Rows read from a database's pages equal SQLite's; odd pages are left to SQLite."""

import random
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from bodylog.errors import BodylogError
from bodylog.logs.formats import open_log, payloads
from bodylog.logs.rosbag2 import pages
from bodylog.logs.rosbag2 import rows as sqlite_rows
from bodylog.logs.rosbag2 import sqlite3 as sqlite
from fixtures.by_hand import db3

START = 1_700_000_000_000_000_000
TYPE = "std_msgs/msg/UInt8"


def rows(draw, count, largest):
    times = sorted(START + draw.randrange(10**12) for _ in range(count))
    return [(f"/{draw.randrange(3)}", t, draw.randbytes(draw.randrange(largest))) for t in times]


def changed(path: Path, *statements: str) -> None:
    with closing(sqlite3.connect(path, isolation_level=None)) as store:
        for statement in statements:
            store.execute(statement)


def everything(path: Path, topics=None):
    try:
        with open_log(path) as log:
            wanted = None if topics is None else [topic.id for topic in log.topics if topic.name in topics]
            found = [
                (batch.topic_id, log_ns, bytes(payload))
                for batch in log.batches(wanted)
                for log_ns, payload in zip(batch.log_ns.tolist(), payloads(batch), strict=True)
            ]
            # by topic: pages and rows come in blocks of different lengths, which hold several topics
            counts = [topic.messages for topic in log.topics]
            return sorted(found, key=lambda one: one[0]), log.findings == (), log.start_ns, log.end_ns, counts
    except BodylogError as problem:
        return str(problem)


@pytest.fixture
def by_sqlite(monkeypatch):
    def read(path, topics=None):
        with monkeypatch.context() as alone:
            alone.setattr(sqlite, "_pages", lambda _store, _source: None)
            return everything(path, topics)

    return read


@pytest.fixture
def asked(monkeypatch):
    """How many blocks SQLite read."""
    made, block = [], sqlite_rows._block
    monkeypatch.setattr(sqlite_rows, "_block", lambda rows, low: made.append(len(rows)) or block(rows, low))
    return made


CHANGES = {
    "as it is": (),
    "holes": ("DELETE FROM messages WHERE id % 3 = 0",),
    "sparse": ("DELETE FROM messages WHERE id % 50", "UPDATE messages SET id = id + 70000000000 WHERE id > 100"),
    "far apart": ("UPDATE messages SET id = id * 1000003",),
    "vacuumed in pages of 512 bytes": ("PRAGMA page_size = 512", "VACUUM"),
    "vacuumed in pages of 65536 bytes": ("PRAGMA page_size = 65536", "VACUUM"),
    "auto-vacuum": ("PRAGMA auto_vacuum = FULL", "VACUUM", "DELETE FROM messages WHERE id % 7 = 0"),
    "all kinds of integers": ("UPDATE messages SET timestamp = timestamp % 300 WHERE id % 5 = 0",
                              "UPDATE messages SET timestamp = timestamp % 100000000000 WHERE id % 5 = 1",
                              "UPDATE messages SET timestamp = id % 2 WHERE id % 5 = 2",
                              "UPDATE messages SET timestamp = -timestamp WHERE id % 5 = 3"),
    "empty": ("DELETE FROM messages",),
}  # fmt: skip


@pytest.mark.parametrize("name", CHANGES)
@pytest.mark.parametrize("count", [5, 3000])
def test_pages_equal_sqlite(tmp_path, by_sqlite, asked, name, count):
    draw, path = random.Random(count), tmp_path / "x.db3"
    db3(path, rows(draw, count, 300), TYPE, None)
    changed(path, *CHANGES[name])
    found = everything(path)
    assert not asked or "512" in name  # where a payload of 300 bytes does not fit a page
    assert found == by_sqlite(path)
    assert everything(path, ["/1"]) == by_sqlite(path, ["/1"])


def test_rows_of_short_databases_are_read_once(tmp_path, monkeypatch):
    path = tmp_path / "x.db3"
    db3(path, rows(random.Random(2), 3000, 300), TYPE, None)
    with monkeypatch.context() as long:
        long.setattr(pages, "_SHORT", path.stat().st_size - 1)
        expected = everything(path)
    read, plain = [], pages.Pages._read
    monkeypatch.setattr(pages.Pages, "_read", lambda self, leaves: read.extend(leaves.tolist()) or plain(self, leaves))
    monkeypatch.setattr(sqlite.Db3Log, "_counts", lambda *_: pytest.fail("counted by SQLite"))
    assert everything(path) == expected
    assert 0 < len(read) == len(set(read))


ODD = {
    "a negative rowid": "UPDATE messages SET id = -5 WHERE id = 900",
    "a rowid of nine bytes": "UPDATE messages SET id = 9000000000000000000 WHERE id = 900",
    "no payload": "UPDATE messages SET data = zeroblob(0) WHERE id % 2",
    "a text for a payload": "UPDATE messages SET data = 'text' WHERE id = 900",
    "a text for a topic": "UPDATE messages SET topic_id = 'one' WHERE id = 900",
    "a broken time": "UPDATE messages SET timestamp = 1.5 WHERE id = 900",
    "a large payload": "UPDATE messages SET data = randomblob(20000) WHERE id % 400 = 0",
    "one more column": "ALTER TABLE messages ADD COLUMN more INTEGER DEFAULT 7",
    "a write-ahead log": "PRAGMA journal_mode = WAL",
}


@pytest.mark.parametrize("name", ODD)
def test_rows_equal_sqlite_for_odd_tables(tmp_path, by_sqlite, name):
    path = tmp_path / "x.db3"
    db3(path, rows(random.Random(1), 1500, 100), TYPE, None)
    changed(path, ODD[name])
    assert everything(path) == by_sqlite(path)


@pytest.mark.parametrize("seed", range(40))
def test_pages_give_no_row_that_sqlite_does_not(tmp_path, by_sqlite, seed):
    draw, path = random.Random(seed), tmp_path / "x.db3"
    db3(path, rows(draw, 400, 100), TYPE, None)
    whole = bytearray(path.read_bytes())
    for _ in range(draw.randrange(1, 6)):
        page = draw.randrange(1, len(whole) // 4096)  # anywhere, and where pages say what is in them
        whole[page * 4096 + draw.choice([draw.randrange(4096), draw.randrange(60)])] ^= 1 << draw.randrange(8)
    path.write_bytes(whole)
    ours, theirs = everything(path), by_sqlite(path)
    if isinstance(ours, str) or isinstance(theirs, str):
        assert ours == theirs
    else:
        assert set(ours[0]) <= set(theirs[0]) and len(ours[0]) <= len(theirs[0])

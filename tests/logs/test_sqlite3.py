"""rosbag2 databases: never modified, read including the write-ahead log, read past damage."""

import shutil
import sqlite3
import struct
from collections import Counter
from contextlib import closing
from pathlib import Path

import pytest

from bodylog.errors import LogError
from bodylog.logs.formats import open_log, payload_views
from fixtures import by_hand

from . import peers

FOLDER = Path(__file__).parents[2] / "fixtures" / "containers"
KIND = "std_msgs/msg/Float64"


def some(count: int, size: int = 12) -> list[by_hand.Message]:
    return [("/b" if number % 3 == 2 else "/a", 1000 + number, b"\x00\x01\x00\x00" + struct.pack("<d", number)
             + bytes(size - 12)) for number in range(count)]  # fmt: skip


def test_open_takes_definitions_from_the_file_or_the_standard() -> None:
    for name in ("humble.db3", "iron.db3"):
        with open_log(FOLDER / name) as log:
            assert {topic.definition_encoding for topic in log.topics} == {"ros2msg"}
            assert all(b"float64 data" in topic.definition for topic in log.topics)


def test_open_reads_an_unknown_type(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    by_hand.db3(path, some(3), "nobody_msgs/msg/Unknown", None)
    with open_log(path) as log:
        assert {(topic.definition, topic.type) for topic in log.topics} == {(b"", "nobody_msgs/msg/Unknown")}
        assert sum(len(batch.log_ns) for batch in log.batches()) == 3


def test_open_writes_nothing_beside_the_log(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    shutil.copyfile(FOLDER / "humble.db3", path)
    with closing(sqlite3.connect(path)) as store:
        assert store.execute("PRAGMA journal_mode=WAL").fetchone() == ("wal",)
    path.chmod(0o400)
    before = (path.read_bytes(), path.stat().st_mtime_ns)
    with open_log(path) as log:
        for _ in log.batches():
            assert list(tmp_path.iterdir()) == [path]
    assert (path.read_bytes(), path.stat().st_mtime_ns) == before


def test_open_reads_the_write_ahead_log(tmp_path: Path) -> None:
    recording, found = tmp_path / "recording.db3", tmp_path / "found"
    found.mkdir()
    by_hand.db3(recording, some(5), KIND, None)
    with closing(sqlite3.connect(recording)) as store:
        store.execute("PRAGMA journal_mode=WAL")
        with store:
            store.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, 9999, x'00010000')")
        for file in tmp_path.glob("recording.db3*"):  # left by a killed recorder
            shutil.copyfile(file, found / file.name)
    before = sorted(file.name for file in found.iterdir() if "shm" not in file.name)
    assert len(peers.ours(found / "recording.db3")) == 6
    assert sorted(file.name for file in found.iterdir() if "shm" not in file.name) == before
    assert len(peers.sqlite_raw(found / "recording.db3")) == 5


def test_batches_read_only_requested_topics(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    by_hand.db3(path, some(30), KIND, None)
    with open_log(path) as log:
        for topic in log.topics:
            found = [bytes(part) for batch in log.batches([topic.id]) for part in payload_views(batch)]
            assert found == [payload for name, _, payload in some(30) if name == topic.name]
            assert topic.messages == len(found)


def test_batches_are_in_recording_order(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    shuffled = some(20)[::-1]
    by_hand.db3(path, shuffled, KIND, None)
    with open_log(path) as log:
        assert (log.start_ns, log.end_ns) == (1000, 1019)
        (wanted,) = [topic.id for topic in log.topics if topic.name == "/b"]
        times = [time for batch in log.batches([wanted]) for time in batch.log_ns.tolist()]
    assert times == [time for topic, time, _ in shuffled if topic == "/b"]


def test_open_loses_only_the_rows_of_a_damaged_page(tmp_path: Path) -> None:
    """A leaf in the middle is overwritten: rows before and after it are read, its own counted."""
    path = tmp_path / "x.db3"
    by_hand.db3(path, some(3000, 100), KIND, None)
    data = bytearray(path.read_bytes())
    page = data.index(struct.pack("<d", 1500.0) + bytes(88)) // 4096
    data[page * 4096 : page * 4096 + 4096] = b"\xff" * 4096
    path.write_bytes(data)
    found = {payload for _, _, payload in peers.ours(path)}
    numbers = sorted(int(struct.unpack_from("<d", payload, 4)[0]) for payload in found)
    missing = sorted(set(range(3000)) - set(numbers))
    assert missing == list(range(missing[0], missing[-1] + 1))
    assert 1500 in missing
    assert len(missing) < 60
    with open_log(path) as log:
        for _ in log.batches():
            pass
        (lost,) = [finding.text for finding in log.findings if finding.severity == "lost"]
    assert f"{len(missing)} messages" in lost
    with pytest.raises(LogError, match="lost"):
        open_log(path, strict=True)


def test_rows_end_on_cyclic_pages(tmp_path: Path) -> None:
    """A leaf in the middle is overwritten with its parent page, and so on for each leaf."""
    path = tmp_path / "x.db3"
    by_hand.db3(path, some(3000, 100), KIND, None)
    whole, expected, counts = path.read_bytes(), Counter(peers.ours(path)), []
    first, last = (whole.index(struct.pack("<d", number) + bytes(88)) // 4096 for number in (100.0, 2900.0))
    pages = [whole[at : at + 4096] for at in range(0, len(whole), 4096)]
    (above,) = [page for page in pages[1:] if page[0] == 5]
    for leaf in range(first, last, 9):
        path.write_bytes(b"".join([*pages[:leaf], above, *pages[leaf + 1 :]]))
        found = Counter(peers.ours(path))
        assert found <= expected
        counts.append(found.total())
    assert min(counts) > 2900 and counts.count(3000) < 2


def test_rows_read_the_row_before_a_damaged_one(tmp_path: Path) -> None:
    """SQLite's cursor steps ahead, so an error of a row appears one row early."""
    path = tmp_path / "x.db3"
    by_hand.db3(path, some(400, 3000), KIND, None)
    data = bytearray(path.read_bytes())
    at = data.index(struct.pack("<d", 200.0)) // 4096 * 4096
    data[at : at + 4096] = bytes(4096)
    path.write_bytes(data)
    found = {int(struct.unpack_from("<d", payload, 4)[0]) for _, _, payload in peers.ours(path)}
    missing = sorted(set(range(400)) - found)
    assert 200 in missing and len(missing) <= 2


def test_rows_report_a_row_of_the_wrong_type(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    by_hand.db3(path, some(10), KIND, None)
    with closing(sqlite3.connect(path)) as store, store:
        store.execute("UPDATE messages SET data = 'text' WHERE id = 4")
    with open_log(path) as log:
        assert sum(len(batch.log_ns) for batch in log.batches()) == 9
        assert [finding.text for finding in log.findings if "row 4 of messages is damaged" in finding.text]


def test_open_reports_messages_without_a_topic(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    by_hand.db3(path, some(9), KIND, None)
    with closing(sqlite3.connect(path)) as store, store:
        store.execute("DELETE FROM topics WHERE name = '/b'")
    with open_log(path) as log:
        assert [(topic.name, topic.messages) for topic in log.topics] == [("/a", 6)]
        assert sum(len(batch.log_ns) for batch in log.batches()) == 6
        assert "3 messages" in log.findings[0].text


def test_open_refuses_other_databases(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    with closing(sqlite3.connect(path)) as store, store:
        store.execute("CREATE TABLE films(id INTEGER)")
    with pytest.raises(LogError, match="not readable as a rosbag2 database"):
        open_log(path)


def test_open_accepts_unusual_file_names(tmp_path: Path) -> None:
    path = tmp_path / "a?b#c %41.db3"
    by_hand.db3(path, some(3), KIND, None)
    assert len(peers.ours(path)) == 3


def test_open_reads_large_and_small_payloads(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    mixed = [("/a", number, bytes(1 << 20 if number % 40 == 39 else 8)) for number in range(120)]
    by_hand.db3(path, mixed, KIND, None)
    assert peers.ours(path) == Counter(mixed)

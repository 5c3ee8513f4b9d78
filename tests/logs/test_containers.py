"""Every recorded log: all that any other reader reads, we read, payload by payload; and what is no log is refused."""

import csv
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from bodylog.errors import LogError
from bodylog.logs.formats import open_log, payloads
from bodylog.types import Batch

from . import peers

LOGS = Path(__file__).parents[2].parent / "shared" / "logs"
INDEX = LOGS / "INDEX.csv"
ROWS = list(csv.DictReader(INDEX.read_text().splitlines())) if INDEX.is_file() else []
KNOWN = {row["file"]: int(row["messages"] or 0) for row in ROWS if "foxglove__mcap/" not in row["file"]}
UNREADABLE = ("Dockerfile.mcap", "empty-file.bag")
SALVAGED = {"test_truncated.bag": 3, "test_unindexed.bag": 14, "gps.bag.active": 30445, "out.mcap": 256}
"""Messages where the index of the logs knows none, because no reader of its time read them."""
recorded = pytest.mark.skipif(not ROWS, reason=f"the recorded logs are not at {LOGS}")
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
"""Other readers leave a file open when they refuse it."""


def readers(path: Path) -> list:
    if path.suffix == ".mcap":
        return [peers.mcap_seeking, peers.mcap_streaming, peers.pybag_raw, peers.rosbags_raw]
    if path.suffix == ".db3":
        return [peers.sqlite_raw, peers.rosbags_raw]
    return [peers.rosbags_raw] if path.suffix in (".bag", "") else []


@recorded
@pytest.mark.parametrize("name", [name for name in KNOWN if not name.endswith(UNREADABLE)])
def test_all_that_any_reader_reads_is_read(name: str) -> None:
    found = peers.ours(LOGS / name)
    assert found.total() == SALVAGED.get(Path(name).name, KNOWN[name])
    for reader in readers(LOGS / name):
        assert not peers.whatever(reader, LOGS / name) - found, f"{reader.__name__} reads more"


@recorded
@pytest.mark.parametrize("name", [name for name in KNOWN if name.endswith(".bag") and KNOWN[name]])
def test_bags_count_as_pybag_counts(name: str) -> None:
    found = Counter(topic for topic, _, _ in peers.ours(LOGS / name).elements())
    assert not peers.pybag_counts(LOGS / name) - found


@recorded
def test_readers_are_really_asked() -> None:
    """The comparison would be empty if every peer refused every file."""
    path = LOGS / "arm" / "reach.mcap"
    assert all(peers.whatever(reader, path) == peers.ours(path) for reader in readers(path))
    path = LOGS / "arm" / "reach.bag"
    assert peers.whatever(peers.rosbags_raw, path) == peers.ours(path)
    assert peers.pybag_counts(path).total() == peers.ours(path).total()


FOLDERS = sorted({file.parent.relative_to(LOGS) for file in LOGS.rglob("metadata.yaml")})


@recorded
@pytest.mark.parametrize("name", FOLDERS, ids=str)
def test_folders_hold_what_rosbags_reads(name: Path) -> None:
    folder, found = LOGS / name, peers.ours(LOGS / name)
    assert not peers.whatever(peers.rosbags_raw, folder) - found
    with open_log(folder) as log:
        assert found.total() == sum(topic.messages for topic in log.topics)


@recorded
def test_two_containers_of_one_motion_agree() -> None:
    bag, folder = (peers.ours(LOGS / "arm" / name).elements() for name in ("reach.bag", "reach_rosbag2"))
    assert Counter(time for _, time, _ in bag) == Counter(time for _, time, _ in folder)


@recorded
@pytest.mark.parametrize("name", UNREADABLE)
def test_what_is_no_log_is_refused(name: str) -> None:
    path = next(LOGS.rglob(name))
    with pytest.raises(LogError, match=r"logs are \.mcap, \.bag, \.db3 or a rosbag2 folder"):
        open_log(path)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "the file is empty"),
        (b"hello", "not a log: it begins with b'hello'"),
        (b"version https://git-lfs.github.com/spec/v1\noid", "git lfs pull"),
        (b"\x89MCAP0\n\x01", "line ends were converted"),
        (b"#ROSBAG V1.2\n", "version 1.2"),
        (b"\x28\xb5\x2f\xfd" + bytes(20), "zstd data is damaged"),
    ],
)
def test_the_message_says_what_the_file_is(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=said) as caught:
        open_log(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_missing_files_and_empty_folders_are_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no such file or folder"):
        open_log(tmp_path / "missing.bag")
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(LogError, match=r"a folder without .db3 or .mcap files \(it holds notes.txt\)"):
        open_log(tmp_path)


def test_payloads_are_views_of_the_batch() -> None:
    data = np.frombuffer(b"abcdefgh", np.uint8)
    batch = Batch(0, np.array([1, 2]), data, np.array([5, 1]), np.array([3, 2]))
    assert [bytes(payload) for payload in payloads(batch)] == [b"fgh", b"bc"]


@recorded
def test_a_message_at_time_zero_begins_the_log_even_if_the_statistics_leave_it_out() -> None:
    path = next(LOGS.glob("ros2__rosbag2/rosbag2_py/**/mcap/**/rewriter_a_0.mcap"))
    with open_log(path) as log:
        assert log.start_ns == min(int(batch.log_ns.min()) for batch in log.batches()) == 0


def test_a_file_that_may_not_be_read_is_an_error_of_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    path = tmp_path / "x.mcap"
    path.write_bytes(b"x")
    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(LogError, match="it cannot be read: Permission denied"):
        open_log(path)

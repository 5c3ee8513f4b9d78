"""Every recorded log: bodylog reads all that any other reader reads, payload by payload; other files are refused."""

import csv
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from bodylog import pipeline
from bodylog.errors import LogError
from bodylog.logs.formats import FORMATS, open_log, payload_views
from bodylog.logs.limits import Input
from bodylog.logs.mcap.reader import McapLog
from bodylog.settings import Settings
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
def test_open_reads_all_that_any_peer_reads(name: str) -> None:
    found = peers.ours(LOGS / name)
    assert found.total() == SALVAGED.get(Path(name).name, KNOWN[name])
    for reader in readers(LOGS / name):
        assert not peers.whatever(reader, LOGS / name) - found, f"{reader.__name__} reads more"


@recorded
@pytest.mark.parametrize("name", [name for name in KNOWN if name.endswith(".bag") and KNOWN[name]])
def test_open_counts_bags_as_pybag(name: str) -> None:
    found = Counter(topic for topic, _, _ in peers.ours(LOGS / name).elements())
    assert not peers.pybag_counts(LOGS / name) - found


@recorded
def test_peers_read_most_files() -> None:
    """The comparison would be empty if every peer refused every file."""
    path = LOGS / "arm" / "reach.mcap"
    assert all(peers.whatever(reader, path) == peers.ours(path) for reader in readers(path))
    path = LOGS / "arm" / "reach.bag"
    assert peers.whatever(peers.rosbags_raw, path) == peers.ours(path)
    assert peers.pybag_counts(path).total() == peers.ours(path).total()


FOLDERS = sorted({file.parent.relative_to(LOGS) for file in LOGS.rglob("metadata.yaml")})


@recorded
@pytest.mark.parametrize("name", FOLDERS, ids=str)
def test_open_reads_folders_as_rosbags(name: Path) -> None:
    folder, found = LOGS / name, peers.ours(LOGS / name)
    assert not peers.whatever(peers.rosbags_raw, folder) - found
    with open_log(folder) as log:
        assert found.total() == sum(topic.messages for topic in log.topics)


@recorded
def test_open_agrees_across_containers() -> None:
    bag, folder = (peers.ours(LOGS / "arm" / name).elements() for name in ("reach.bag", "reach_rosbag2"))
    assert Counter(time for _, time, _ in bag) == Counter(time for _, time, _ in folder)


@recorded
@pytest.mark.parametrize("name", UNREADABLE)
def test_open_refuses_files_that_are_not_logs(name: str) -> None:
    path = next(LOGS.rglob(name))
    with pytest.raises(LogError, match=r"logs are \.mcap, \.bag, \.db3 or a rosbag2 folder"):
        open_log(path)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "the file is empty"),
        (b"hello", "not a log: it begins with b'hello'"),
        (b"version https://git-lfs.github.com/spec/v1\noid", "git lfs pull"),
        (b"\x89MCAP0\n\x01", "line ends were converted"),
        (b"#ROSBAG V1.2\n", "version 1.2"),
        (b"\x28\xb5\x2f\xfd" + bytes(20), "zstd data is damaged"),
    ],
)
def test_open_names_the_kind_of_a_refused_file(tmp_path: Path, content: bytes, text: str) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=text) as caught:
        open_log(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_open_names_missing_files_and_empty_folders(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no such file or folder"):
        open_log(tmp_path / "missing.bag")
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(LogError, match=r"a folder without .db3 or .mcap files \(it holds notes.txt\)"):
        open_log(tmp_path)


def test_payloads_are_views_of_the_batch() -> None:
    data = np.frombuffer(b"abcdefgh", np.uint8)
    batch = Batch(0, np.array([1, 2]), data, np.array([5, 1]), np.array([3, 2]))
    assert [bytes(payload) for payload in payload_views(batch)] == [b"fgh", b"bc"]


@recorded
def test_open_includes_a_message_at_time_zero() -> None:
    path = next(LOGS.glob("ros2__rosbag2/rosbag2_py/**/mcap/**/rewriter_a_0.mcap"))
    with open_log(path) as log:
        assert log.start_ns == min(int(batch.log_ns.min()) for batch in log.batches()) == 0


def test_open_refuses_an_unreadable_file_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    path = tmp_path / "x.mcap"
    path.write_bytes(b"x")
    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(LogError, match="it cannot be read: Permission denied"):
        open_log(path)


def test_a_new_container_is_a_reader_and_one_line_of_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, inside = tmp_path / "log.ours", Path(__file__).parents[2] / "fixtures" / "arm" / "reach.mcap"
    path.write_bytes(b"OURLOG" + inside.read_bytes())

    def open_ours(path: Path, strict: bool, source: Path, limits: Input) -> McapLog:
        (tmp_path / "inside").write_bytes(source.read_bytes()[6:])
        return McapLog(path, strict, tmp_path / "inside", limits)

    with pytest.raises(LogError, match="not a log: it begins with b'OURLOG"):
        open_log(path)
    monkeypatch.setitem(FORMATS, b"OURLOG", open_ours)
    ours, theirs = (
        pipeline.estimate(log, None, tmp_path / f"{log.suffix}.mcap", Settings()) for log in (path, inside)
    )
    assert ours.verdict == theirs.verdict and ours.scores == theirs.scores

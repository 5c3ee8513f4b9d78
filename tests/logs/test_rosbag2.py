"""rosbag2 folders: files in order, topics merged, whatever metadata.yaml holds."""

import shutil
from pathlib import Path

import pytest

from bodylog import logs
from bodylog.errors import LogError
from bodylog.logs.formats import open_log
from fixtures import by_hand

from . import peers

FOLDER = Path(__file__).parents[2] / "fixtures" / "containers"


@pytest.fixture
def split(tmp_path: Path) -> Path:
    shutil.copytree(FOLDER / "split.bag", tmp_path / "x.bag")
    return tmp_path / "x.bag"


def severities(path: Path) -> list[str]:
    with open_log(path) as log:
        for _ in log.batches():
            pass
        return [finding.severity for finding in log.findings]


def test_open_merges_topics_of_all_files(split: Path) -> None:
    with open_log(split) as log:
        assert log.format == "rosbag2"
        assert [(topic.name, topic.messages) for topic in log.topics] == [("/a", 40), ("/b", 20)]
        (wanted,) = [topic.id for topic in log.topics if topic.name == "/b"]
        times = [time for batch in log.batches([wanted]) for time in batch.log_ns.tolist()]
        assert times == sorted(times)
        assert len(times) == 20
        assert log.end_ns - log.start_ns == 590_000_000


def test_members_are_in_number_order(tmp_path: Path) -> None:
    for number in (2, 10, 1):
        by_hand.db3(tmp_path / f"x_{number}.db3", [("/a", number, bytes(12))], "std_msgs/msg/Float64", None)
    with open_log(tmp_path) as log:
        assert [time for batch in log.batches() for time in batch.log_ns.tolist()] == [1, 2, 10]


def test_members_are_in_metadata_order(split: Path) -> None:
    file = split / "metadata.yaml"
    file.write_text(file.read_text().replace("[split_0.db3, split_1.db3", "[split_1.db3, split_0.db3"))
    with open_log(split) as log:
        times = [batch.log_ns[0] for batch in log.batches([0])]
        assert times[0] > times[1]


@pytest.mark.parametrize("text", ["", "[", "rosbag2_bagfile_information: 3", "a: &x [*x, *x]", "\x00\xff", "[]"])
def test_open_survives_unreadable_metadata(split: Path, text: str) -> None:
    (split / "metadata.yaml").write_text(text)
    assert peers.ours(split) == peers.ours(FOLDER / "split.bag")
    assert severities(split) == ["warning"]


def test_open_survives_missing_metadata(split: Path) -> None:
    (split / "metadata.yaml").unlink()
    assert peers.ours(split) == peers.ours(FOLDER / "split.bag")
    assert severities(split) == ["warning"]


@pytest.mark.parametrize("version", range(1, 10))
def test_open_reads_every_metadata_version(split: Path, version: int) -> None:
    """Up to version 3 file names include the folder's name; other differences do not matter."""
    file = split / "metadata.yaml"
    text = file.read_text().replace("version: 5", f"version: {version}")
    file.write_text(text.replace("split_", "x.bag/split_") if version < 4 else text)
    assert peers.ours(split) == peers.ours(FOLDER / "split.bag")
    assert severities(split) == []


def test_members_find_a_renamed_file(split: Path) -> None:
    (split / "split_1.db3").rename(split / "renamed.db3")
    assert peers.ours(split) == peers.ours(FOLDER / "split.bag")
    assert severities(split) == ["warning"]


def test_members_report_files_missing_in_metadata(split: Path) -> None:
    shutil.copyfile(FOLDER / "iron.db3", split / "stray.db3")
    assert peers.ours(split) == peers.ours(FOLDER / "split.bag")
    assert severities(split) == ["info"]


def test_open_reads_other_files_if_one_is_unreadable(split: Path) -> None:
    (split / "split_1.db3").write_bytes(b"nothing")
    assert len(peers.ours(split)) == 40
    assert severities(split) == ["lost"]
    with pytest.raises(LogError):
        open_log(split, strict=True)


def test_open_refuses_an_unreadable_folder(tmp_path: Path) -> None:
    (tmp_path / "x.db3").write_bytes(b"nothing")
    with pytest.raises(LogError, match="none of its files can be read") as caught:
        open_log(tmp_path)
    assert str(caught.value).startswith(str(tmp_path))


def test_open_reads_compressed_files_once(tmp_path: Path) -> None:
    shutil.copyfile(FOLDER / "packed.db3.zstd", tmp_path / "x.db3.zstd")
    assert len(peers.ours(tmp_path)) == 60
    shutil.copyfile(FOLDER / "humble.db3", tmp_path / "x.db3")
    assert len(peers.ours(tmp_path)) == 60


def test_convert_skips_a_link_to_a_missing_file(split: Path, tmp_path: Path) -> None:
    (split / "gone.mcap").symlink_to(tmp_path / "nowhere.mcap")
    logs.convert(split, tmp_path / "out.mcap")
    with open_log(tmp_path / "out.mcap") as log:
        assert [(topic.name, topic.messages) for topic in log.topics] == [("/a", 40), ("/b", 20)]


def test_links_out_of_the_folder_are_not_followed(split: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    first = min(split.glob("*.db3"))
    shutil.move(first, outside / "secret.db3")
    first.symlink_to(outside / "secret.db3")
    (split / "metadata.yaml").unlink()
    (outside / "secret.yaml").write_text("rosbag2_bagfile_information: {relative_file_paths: [../outside/secret.db3]}")
    (split / "metadata.yaml").symlink_to(outside / "secret.yaml")
    with open_log(split) as log:
        texts = [finding.text for finding in log.findings]
        read = {str(member) for member, _ in log._members}
    assert any(f"{first.name}: links out of the folder; not read" in text for text in texts)
    assert any("there is no metadata.yaml" in text for text in texts)
    assert read and str(first) not in read
    (split / "metadata.yaml").unlink()
    (split / "metadata.yaml").write_text("rosbag2_bagfile_information: {relative_file_paths: [../outside/secret.db3]}")
    with open_log(split) as log:
        assert all(member.parent == split for member, _ in log._members)


def test_a_folder_that_is_a_link_itself_is_read(split: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(split)
    with open_log(tmp_path / "link") as log, open_log(split) as same:
        counts = [[topic.messages for topic in one.topics] for one in (log, same)]
        assert counts[0] == counts[1] and not any("links out" in finding.text for finding in log.findings)

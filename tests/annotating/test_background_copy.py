"""Copy and digest a log while it is in use: the same bytes, or nothing."""

import errno
import hashlib
import os
import time
from concurrent.futures import CancelledError

import pytest
from mcap.writer import CompressionType

from bodylog.annotating import annotate, background_copy
from bodylog.annotating.background_copy import Copy
from bodylog.errors import LogError, WriteError
from bodylog.io import atomic_files, temporary
from bodylog.io.atomic_files import hash_files
from tests.annotating.annotated_logs import annotate_log
from tests.logs.written import outgoing, source

PIECE = 8192


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    monkeypatch.setattr(atomic_files, "_PIECE", PIECE)


@pytest.fixture
def log(tmp_path):
    return source(tmp_path / "in.mcap", padding=400, compression=CompressionType.NONE)


def meanwhile(monkeypatch, what):
    """Call a function when the second piece of the log has been read."""
    whole = background_copy.read_pieces

    def interrupted(path):
        for number, piece in enumerate(whole(path)):
            yield piece
            if number == 1:
                what()

    monkeypatch.setattr(background_copy, "read_pieces", interrupted)


@pytest.mark.parametrize("direct", [True, False])
@pytest.mark.parametrize("size", [1, 4095, 4096, PIECE, 10 * PIECE + 5000])
def test_copy_has_the_bytes_and_digest_of_the_source(tmp_path, monkeypatch, direct, size):
    if not direct:
        monkeypatch.delattr(background_copy.os, "O_DIRECT", raising=False)
    raw = os.urandom(size)
    (tmp_path / "in").write_bytes(raw)
    for end in {0, 1, size // 2, size}:
        (tmp_path / "out").write_bytes(b"")
        with Copy(tmp_path / "in", tmp_path / "out", end) as copy:
            assert copy.digest() == hashlib.sha256(raw).hexdigest()
        assert (tmp_path / "out").read_bytes() == raw[:end]


def test_copy_digests_a_folder_file_by_file(tmp_path):
    for name in ("b", "a"):
        (tmp_path / name).write_bytes(os.urandom(3 * PIECE + 7))
    with Copy(tmp_path) as copy:
        assert copy.digest() == hash_files(tmp_path)


def test_copy_stops_after_a_piece(tmp_path, monkeypatch):
    (tmp_path / "in").write_bytes(bytes(100 * PIECE))
    whole, given = background_copy.read_pieces, []

    def slow(path):
        for piece in whole(path):
            time.sleep(0.2)
            given.append(len(piece))
            yield piece

    monkeypatch.setattr(background_copy, "read_pieces", slow)
    with Copy(tmp_path / "in") as copy:
        pass
    assert len(given) <= 2
    with pytest.raises(CancelledError):
        copy.digest()


@pytest.mark.parametrize("change", [-3 * PIECE, 100])
def test_annotating_refuses_a_log_that_changes_size(tmp_path, log, monkeypatch, change):
    size = log.stat().st_size
    assert size > 8 * PIECE
    meanwhile(monkeypatch, lambda: os.truncate(log, size + change))
    with pytest.raises(LogError, match=f"had {size} bytes, but {size + change} when .* still being recorded"):
        annotate_log(log, outgoing(), {}, tmp_path / "out.mcap")
    assert list(tmp_path.iterdir()) == [log]


def test_annotating_reports_a_full_disk_and_leaves_nothing(tmp_path, log, monkeypatch):
    def full():
        raise OSError(errno.ENOSPC, "No space left on device")

    meanwhile(monkeypatch, full)
    with pytest.raises(WriteError, match="No space left"):
        annotate_log(log, outgoing(), {}, tmp_path / "out.mcap")
    assert list(tmp_path.iterdir()) == [log]


@pytest.mark.parametrize("first", ["the copy", "the messages"])
def test_annotating_is_independent_of_call_order(tmp_path, log, monkeypatch, first):
    messages = outgoing()
    annotate_log(log, messages, {"input": hash_files(log)}, tmp_path / "plain.mcap")
    if first == "the messages":
        meanwhile(monkeypatch, lambda: time.sleep(0.3))
    with annotate.open_annotation(log, tmp_path / "out.mcap") as under_way:
        if first == "the copy":
            under_way.digest()
        under_way.add(messages)
        under_way.about({"input": under_way.digest()})
    assert (tmp_path / "out.mcap").read_bytes() == (tmp_path / "plain.mcap").read_bytes()


@pytest.mark.parametrize("problem", [LogError("no joints"), KeyboardInterrupt(), MemoryError()])
def test_annotating_leaves_nothing_after_an_error(tmp_path, log, problem):
    (tmp_path / "out.mcap").write_bytes(b"of an earlier run")
    with pytest.raises(type(problem)), annotate.open_annotation(log, tmp_path / "out.mcap") as under_way:
        assert len(list(tmp_path.iterdir())) == 3
        under_way.add(outgoing())
        raise problem
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.mcap", "out.mcap"]
    assert (tmp_path / "out.mcap").read_bytes() == b"of an earlier run"


@pytest.mark.parametrize(("kernel", "age"), [(temporary.machine_id(), 0.0), ("0" * 8, 2 * temporary.FOREIGN_S)])
def test_annotating_removes_left_overs_of_a_killed_run(tmp_path, log, kernel, age):
    annotate_log(log, outgoing(), {}, tmp_path / "plain.mcap")
    stale = tmp_path / f".{kernel}-{'a' * 16}{temporary.PART}"
    stale.write_bytes(bytes(2 * log.stat().st_size))
    stale.chmod(0o400)
    os.utime(stale, (time.time() - age,) * 2)
    annotate_log(log, outgoing(), {}, tmp_path / "out.mcap")
    assert (tmp_path / "out.mcap").read_bytes() == (tmp_path / "plain.mcap").read_bytes() and not stale.exists()


@pytest.mark.parametrize("done", ["nothing", "the messages alone"])
def test_annotating_replaces_nothing_when_unfinished(tmp_path, log, done):
    with (
        pytest.raises(LogError, match="not written correctly"),
        annotate.open_annotation(log, tmp_path / "out.mcap") as under_way,
    ):
        if done != "nothing":
            under_way.add(outgoing())
    assert list(tmp_path.iterdir()) == [log]

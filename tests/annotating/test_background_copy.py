"""Copy and digest a log while it is in use: the same bytes, or nothing."""

import errno
import fcntl
import hashlib
import os
import struct
import threading
import time
from concurrent.futures import CancelledError

import pytest
from mcap.writer import CompressionType

from bodylog.annotating import annotate, background_copy
from bodylog.annotating.background_copy import Copy
from bodylog.errors import LogError, WriteError
from bodylog.io import temporary
from bodylog.io.atomic_files import hash_files
from tests.logs.written import outgoing, source

PIECE = 8192


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    monkeypatch.setattr(background_copy, "_PIECE", PIECE)


@pytest.fixture
def log(tmp_path):
    return source(tmp_path / "in.mcap", padding=400, compression=CompressionType.NONE)


def meanwhile(monkeypatch, what):
    """Call a function when the second piece of the log has been read."""
    whole = background_copy.iter_mapped

    def interrupted(path, size):
        for number, (piece, drop) in enumerate(whole(path, size)):
            yield piece, drop
            if number == 1:
                what()

    monkeypatch.setattr(background_copy, "iter_mapped", interrupted)


def digest_after(monkeypatch, event):
    """Let the digest wait for an event."""
    update = background_copy._Digest._update

    def late(*arguments):
        assert event.wait(10)
        update(*arguments)

    monkeypatch.setattr(background_copy._Digest, "_update", late)


@pytest.mark.parametrize("direct", [True, False])
@pytest.mark.parametrize("size", [1, 4095, 4096, PIECE, 3 * PIECE, 10 * PIECE + 5000])
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


def test_copy_delays_short_logs(tmp_path, monkeypatch):
    raw = os.urandom(3 * PIECE)
    (tmp_path / "in").write_bytes(raw)
    (tmp_path / "out").write_bytes(b"")
    with Copy(tmp_path / "in", tmp_path / "out", len(raw)) as copy:
        time.sleep(0.1)
        assert (tmp_path / "out").read_bytes() == b""
        copy.begin()
        _until(lambda: (tmp_path / "out").read_bytes() == raw)
    monkeypatch.setattr(background_copy, "_LONG", len(raw) - 1)
    (tmp_path / "out").write_bytes(b"")
    with Copy(tmp_path / "in", tmp_path / "out", len(raw)):
        _until(lambda: (tmp_path / "out").read_bytes() == raw)


def test_copy_does_not_block_an_interrupted_process(tmp_path):
    (tmp_path / "in").write_bytes(bytes(PIECE))
    (tmp_path / "out").write_bytes(b"")
    before = threading.active_count()
    Copy(tmp_path / "in", tmp_path / "out", PIECE)  # interrupted here, before the block is entered
    assert threading.active_count() == before


def _until(done):
    end = time.monotonic() + 10
    while not done():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_copy_digests_a_folder_file_by_file(tmp_path):
    for name in ("b", "a"):
        (tmp_path / name).write_bytes(os.urandom(3 * PIECE + 7))
    with Copy(tmp_path) as copy:
        assert copy.digest() == hash_files(tmp_path)


def test_copy_is_ahead_of_the_digest_by_few_pieces(tmp_path, monkeypatch):
    raw, digesting = os.urandom(20 * PIECE), threading.Event()
    (tmp_path / "in").write_bytes(raw)
    (tmp_path / "out").write_bytes(b"")
    digest_after(monkeypatch, digesting)
    with Copy(tmp_path / "in", tmp_path / "out", len(raw)) as copy:
        copy.begin()
        ahead = background_copy._AHEAD * PIECE
        _until(lambda: (tmp_path / "out").stat().st_size >= ahead)
        time.sleep(0.1)
        assert (tmp_path / "out").read_bytes() == raw[:ahead]
        digesting.set()
        assert copy.digest() == hashlib.sha256(raw).hexdigest()
    assert (tmp_path / "out").read_bytes() == raw


def test_annotating_verifies_the_copy_before_the_digest_is_made(tmp_path, log, monkeypatch):
    verified = threading.Event()
    monkeypatch.setattr(annotate, "verify_message_count", lambda *_: verified.set())
    monkeypatch.setattr(background_copy, "_PIECE", log.stat().st_size)
    digest_after(monkeypatch, verified)
    annotate.annotate_log(log, outgoing(), {}, tmp_path / "out.mcap")


def test_copy_stops_after_a_piece(tmp_path, monkeypatch):
    (tmp_path / "in").write_bytes(bytes(100 * PIECE))
    whole, given = background_copy.iter_mapped, []

    def slow(path, size):
        for piece, drop in whole(path, size):
            time.sleep(0.2)
            given.append(len(piece))
            yield piece, drop

    monkeypatch.setattr(background_copy, "iter_mapped", slow)
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
        annotate.annotate_log(log, outgoing(), {}, tmp_path / "out.mcap")
    assert list(tmp_path.iterdir()) == [log]


def test_annotating_reports_a_full_disk_and_leaves_nothing(tmp_path, log, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(background_copy.os, "pwrite", full)
    with pytest.raises(WriteError, match="No space left"):
        annotate.annotate_log(log, outgoing(), {}, tmp_path / "out.mcap")
    assert list(tmp_path.iterdir()) == [log]


@pytest.mark.parametrize("first", ["the copy", "the messages"])
def test_annotating_is_independent_of_call_order(tmp_path, log, monkeypatch, first):
    messages = outgoing()
    annotate.annotate_log(log, messages, {"input": hash_files(log)}, tmp_path / "plain.mcap")
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
    annotate.annotate_log(log, outgoing(), {}, tmp_path / "plain.mcap")
    stale = tmp_path / f".{kernel}-{'a' * 16}{temporary.PART}"
    stale.write_bytes(bytes(2 * log.stat().st_size))
    stale.chmod(0o400)
    os.utime(stale, (time.time() - age,) * 2)
    annotate.annotate_log(log, outgoing(), {}, tmp_path / "out.mcap")
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


def test_copy_shares_blocks_where_possible(log, tmp_path, monkeypatch):
    """Only the remainder after the last whole block is written."""
    written, plain, asked = [], background_copy._Target.write, []

    def shared(handle, request, argument):
        source, offset, size, at = struct.unpack("=qQQQ", argument)
        asked.append((request, offset, size, at))
        os.pwrite(handle, os.pread(source, size, offset), at)

    def write(self, piece, at):
        written.append(len(piece))
        plain(self, piece, at)

    monkeypatch.setattr(fcntl, "ioctl", shared)
    monkeypatch.setattr(background_copy._Target, "write", write)
    out, end = tmp_path / "out.mcap", log.stat().st_size - 5
    out.touch()
    with Copy(log, out, end) as copy:
        assert copy.digest() == hash_files(log)
    assert out.read_bytes() == log.read_bytes()[:end]
    assert asked == [(background_copy._FICLONERANGE, 0, end // 4096 * 4096, 0)]
    assert sum(written) == end % 4096

import errno
import fcntl
import os
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from bodylog.errors import OutputError, WriteError
from bodylog.io.atomic_files import ensure_dir, hash_files, read_limited_text, replace_atomically
from bodylog.io.temporary import (
    FOREIGN_S,
    PART,
    create_scratch_folder,
    machine_id,
    remove_stale,
    try_lock,
)

WRITER = """
import sys
from pathlib import Path
from bodylog.io.atomic_files import replace_atomically
with replace_atomically(Path(sys.argv[1])) as beside:
    beside.write_bytes(b"half")
    print("started", flush=True)
    sys.stdin.read()
"""


@contextmanager
def writing(path):
    """Another process in the middle of writing `path`; killed at the end."""
    command = [sys.executable, "-c", WRITER, path]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"started\n"
        try:
            yield process
        finally:
            process.kill()


def test_replacing_replaces_or_leaves_the_old_file(tmp_path):
    path = tmp_path / "out.bin"
    with replace_atomically(path) as beside:
        beside.write_bytes(b"first")
    with pytest.raises(RuntimeError), replace_atomically(path) as beside:
        beside.write_bytes(b"second")
        raise RuntimeError
    assert path.read_bytes() == b"first"
    assert list(tmp_path.iterdir()) == [path]


def test_replacing_writes_the_target_of_a_link(tmp_path):
    """Links stay links, also chains and links to missing files; a failure keeps the old file."""
    elsewhere, link, further = tmp_path / "elsewhere", tmp_path / "link", tmp_path / "further"
    elsewhere.mkdir()
    link.symlink_to("elsewhere/out.bin")
    further.symlink_to(link)
    for content in (b"first", b"second"):
        with replace_atomically(further) as beside:
            assert beside.parent == elsewhere
            beside.write_bytes(content)
        assert (elsewhere / "out.bin").read_bytes() == content and link.is_symlink() and further.is_symlink()
    with pytest.raises(RuntimeError), replace_atomically(link) as beside:
        raise RuntimeError
    assert (elsewhere / "out.bin").read_bytes() == b"second" and [*elsewhere.iterdir()] == [elsewhere / "out.bin"]


def test_replacing_keeps_permissions(tmp_path, monkeypatch):
    path = tmp_path / "out.bin"
    path.write_bytes(b"mine")
    path.chmod(0o640)
    with replace_atomically(path) as beside:
        beside.write_bytes(b"new")
    assert (path.read_bytes(), path.stat().st_mode & 0o777) == (b"new", 0o640)
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write to everything
    with pytest.raises(OutputError, match="write-protected"), replace_atomically(path):
        pass
    assert [*tmp_path.iterdir()] == [path] and path.read_bytes() == b"new"


def test_replacing_refuses_broken_links(tmp_path):
    astray, circle = tmp_path / "astray", tmp_path / "circle"
    astray.symlink_to("no/out.bin")
    circle.symlink_to("circle")
    with pytest.raises(OutputError, match=r"mkdir -p .*/no$"), replace_atomically(astray):
        pass
    with pytest.raises(OutputError, match="leads back to itself"), replace_atomically(circle):
        pass
    assert circle.is_symlink()


def test_ensure_dir_creates_the_target_of_a_link(tmp_path):
    (tmp_path / "link").symlink_to("folder")
    assert ensure_dir(tmp_path / "link").is_dir() and (tmp_path / "folder").is_dir()


def test_text_reads_a_pipe_within_limits(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with subprocess.Popen(["sh", "-c", f"echo häßlich > '{tmp_path}/pipe'"]):
        assert read_limited_text(tmp_path / "pipe", 10) == "häßlich\n"
    with pytest.raises(OSError, match="more than 1000 bytes"):
        read_limited_text(Path("/dev/zero"), 1000)


def test_replacing_advises_mkdir(tmp_path):
    with pytest.raises(OutputError, match="mkdir -p"), replace_atomically(tmp_path / "no" / "out.bin"):
        pass


def test_sha256_of_a_folder_uses_name_order(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "b").write_bytes(b"2")
    (folder / "a").write_bytes(b"1")
    (tmp_path / "both").write_bytes(b"12")
    assert hash_files(folder) == hash_files(tmp_path / "both")


def test_replacing_refuses_a_folder_or_device(tmp_path):
    with pytest.raises(OutputError, match="is a folder"), replace_atomically(tmp_path):
        pass
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OutputError, match="is a device"), replace_atomically(tmp_path / "pipe"):
        pass
    assert (tmp_path / "pipe").is_fifo()


def _parts(folder):
    return {path for path in folder.iterdir() if path.name.endswith(PART)}


def test_replacing_removes_left_overs_of_killed_runs(tmp_path):
    path = tmp_path / "out [1].bin"
    with writing(path):
        (left,) = _parts(tmp_path)
    foreign = tmp_path / ".other.bin.1.part"
    foreign.write_bytes(b"of another program")
    with writing(tmp_path / "other.bin"):
        (other,) = _parts(tmp_path)
        assert other != left and not left.exists()
    assert other.read_bytes() == b"half"
    with writing(path) as living:
        (theirs,) = _parts(tmp_path)
        assert theirs != other
        with replace_atomically(path) as beside:
            beside.write_bytes(b"whole")
        assert sorted(tmp_path.iterdir()) == sorted([path, theirs, foreign])
        living.communicate(timeout=60)
    assert path.read_bytes() == b"half"
    assert sorted(tmp_path.iterdir()) == sorted([path, foreign])


def test_replacing_keeps_files_of_another_machine_for_a_day(tmp_path):
    """Some network disks lock per machine, so other machines' files look unlocked."""
    theirs = tmp_path / f".0badcafe-1{PART}"
    theirs.touch()
    remove_stale(tmp_path, f".*{PART}")
    assert theirs.exists() and machine_id() != "0badcafe"
    os.utime(theirs, (0, theirs.stat().st_mtime - FOREIGN_S - 1))
    remove_stale(tmp_path, f".*{PART}")
    assert not theirs.exists()


def test_replacing_removes_nothing_without_locks(tmp_path, monkeypatch):
    def flock(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    left = tmp_path / f".{machine_id()}-1{PART}"
    left.touch()
    with replace_atomically(tmp_path / "a") as first, replace_atomically(tmp_path / "a") as second:
        first.write_bytes(b"1")
        second.write_bytes(b"2")
        assert _parts(tmp_path) == {left, first, second}
    assert sorted(tmp_path.iterdir()) == sorted([left, tmp_path / "a"]) and (tmp_path / "a").read_bytes() == b"1"


SAME = """
import os, sys
from pathlib import Path
if sys.argv[2] == "pretended":
    os.getpid = lambda: 1
from bodylog.io.atomic_files import replace_atomically
assert os.getpid() == int(sys.argv[3])
for _ in range(100):
    with replace_atomically(Path(sys.argv[1])) as beside:
        beside.write_bytes(b"whole")
"""
ALONE = ("unshare", "--user", "--map-root-user", "--pid", "--fork")


def _same_number(path, how):
    """Two processes with equal ids that write one file, as in two containers."""
    command = [sys.executable, "-c", SAME, path, how, "1"]
    return subprocess.Popen([*ALONE, *command] if how == "container" else command, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("how", ["pretended", "container"])
def test_replacing_is_safe_for_equal_process_ids(tmp_path, how):
    if how == "container" and subprocess.run([*ALONE, "true"], capture_output=True).returncode:
        pytest.skip("processes cannot have numbers of their own here (unshare)")
    pair = [_same_number(tmp_path / "out", how) for _ in range(2)]
    errors = [process.communicate(timeout=60)[1] for process in pair]
    assert [process.returncode for process in pair] == [0, 0], errors
    assert [*tmp_path.iterdir()] == [tmp_path / "out"] and (tmp_path / "out").read_bytes() == b"whole"


MANY = """
import sys
from pathlib import Path
from bodylog.io.atomic_files import replace_atomically
for i in range(300):
    with replace_atomically(Path(sys.argv[1]) / f"{sys.argv[2]}-{i % 5}") as beside:
        with beside.open("r+b") as stream:
            stream.write(b"whole")
"""


def test_replacing_is_safe_for_concurrent_runs(tmp_path):
    """A file that is created but not yet locked looks like a left-over."""
    writers = [subprocess.Popen([sys.executable, "-c", MANY, tmp_path, str(i)]) for i in range(4)]
    assert [writer.wait(timeout=60) for writer in writers] == [0] * 4
    assert {path.read_bytes() for path in tmp_path.iterdir()} == {b"whole"} and len(list(tmp_path.iterdir())) == 20


def test_remove_stale_removes_an_unlocked_folder(tmp_path):
    folder = tmp_path / f".{machine_id()}-1{PART}"
    folder.mkdir()
    (folder / "log.mcap").touch()
    (folder / "link").symlink_to(tmp_path)
    with try_lock(folder) as ours:
        remove_stale(tmp_path, f".*{PART}")
        assert ours and folder.is_dir()
    remove_stale(tmp_path, f".*{PART}")
    assert not list(tmp_path.iterdir())


def test_scratch_keeps_users_folders(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    users = tmp_path / "bodylog-results"
    users.mkdir()
    for left in (users, tmp_path / f"bodylog-{machine_id()}-{'0' * 16}", tmp_path / f"bodylog-0badcafe-{'0' * 16}"):
        left.mkdir(exist_ok=True)
        os.utime(left, (0, left.stat().st_mtime - FOREIGN_S - 1))
    with create_scratch_folder() as folder:
        assert sorted(tmp_path.iterdir()) == sorted([users, folder])
    assert list(tmp_path.iterdir()) == [users]


SWEEPS = """
import sys
from pathlib import Path
from bodylog.io.atomic_files import replace_atomically
from bodylog.io.temporary import create_scratch_folder, remove_temporary_files
place = Path(sys.argv[1])
with create_scratch_folder(place) as folder, create_scratch_folder(place) as other, replace_atomically(place / "out") as beside:
    (folder / "deep").mkdir()
    (folder / "deep" / "file").touch()
    assert len(list(place.iterdir())) == 3
    remove_temporary_files()
    print(list(place.iterdir()))
"""


def test_sweep_removes_everything_temporary(tmp_path):
    done = subprocess.run([sys.executable, "-c", SWEEPS, tmp_path], capture_output=True, text=True)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize(("number", "kind"), [
    (errno.ENOSPC, WriteError), (errno.EDQUOT, WriteError), (errno.EFBIG, WriteError), (errno.EIO, WriteError),
    (errno.EROFS, OutputError), (errno.EACCES, OutputError),
])  # fmt: skip
def test_replacing_distinguishes_write_errors_from_output_errors(tmp_path, monkeypatch, number, kind):
    def fail(source, _):
        raise OSError(number, os.strerror(number), os.fspath(source))

    monkeypatch.setattr(os, "replace", fail)
    text_expected = f"out: {os.strerror(number)}; give another"
    with pytest.raises(OutputError, match=text_expected) as raised, replace_atomically(tmp_path / "out") as beside:
        beside.write_bytes(b"new")
    assert type(raised.value) is kind and raised.value.exit_code == (74 if kind is WriteError else 73)
    assert not os.listdir(tmp_path)


def test_replacing_passes_on_errors_of_inputs(tmp_path):
    with pytest.raises(FileNotFoundError), replace_atomically(tmp_path / "out"):
        (tmp_path / "input").read_bytes()
    with pytest.raises(OSError, match="input") as raised, replace_atomically(tmp_path / "out"):
        raise OSError(errno.EIO, "Input/output error", str(tmp_path / "input"))
    assert not isinstance(raised.value, OutputError)

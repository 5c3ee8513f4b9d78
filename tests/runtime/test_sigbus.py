"""A log truncated during reading: one line and exit 65, where the system would kill the process."""

import os
import shutil
import signal
import subprocess
import sys
import zlib
from mmap import PAGESIZE
from pathlib import Path

import pytest

from tests.seeds import first_of

FOLDER = Path(__file__).parents[2] / "fixtures" / "containers"
CUTS = """
import mmap, os, sys, zlib
from bodylog.runtime import sigbus

def cut(path):
    with open(path, "r+b") as stream:
        found = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        os.truncate(path, 5000)
        return bytes(found)
"""
READ = "read = cut(sys.argv[1]); print(len(read), zlib.crc32(read), sigbus.zeroed_pages())"
ZEROS = f"{CUTS}sigbus.install_sigbus_handler(); {READ}"
KILLED = CUTS + "cut(sys.argv[1])"
DISK = CUTS + "sigbus.install_sigbus_handler(); cut(sys.argv.pop(1)); import bodylog_cli; bodylog_cli.main()"
READS = """
import os, sys
import bodylog_cli
from bodylog.logs.mcap.reader import McapLog
from bodylog.logs.rosbag1.reader import BagLog
cut = int(sys.argv.pop(1))
for kind in (McapLog, BagLog):
    def batches(self, ids=None, whole=kind.batches):
        os.truncate(sys.argv[-1], cut)
        return whole(self, ids)
    kind.batches = batches
bodylog_cli.main()
"""
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the process is killed, as the system has it")


def _run(script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, timeout=60)


@LINUX
def test_sigbus_handler_reads_zeros_after_a_cut(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"x" * 100_000)
    done = _run(ZEROS, str(path))
    pages = -(-100_000 // PAGESIZE) - -(-5000 // PAGESIZE)
    assert done.stdout == f"100000 {zlib.crc32(b'x' * 5000 + bytes(95_000))} {pages}\n", done.stderr
    path.write_bytes(b"x" * 100_000)
    assert _run(KILLED, str(path)).returncode == -signal.SIGBUS


@LINUX
@pytest.mark.parametrize("name", ["none.mcap", "zstd.mcap", "unchunked.mcap", "none.bag", "lz4.bag"])
@pytest.mark.parametrize("share", first_of(1, [0.3, 0.0, 0.9]))
def test_commands_refuse_a_log_cut_during_reading(tmp_path: Path, name: str, share: float) -> None:
    path = tmp_path / name
    shutil.copy(FOLDER / name, path)
    size = os.path.getsize(path)
    cut = int(share * size)
    done = _run(READS, str(cut), "doctor", str(path))
    assert done.returncode == 65, done.stderr
    text = f"had {size} bytes, but {cut} while it was read; give it when nobody writes to it"
    assert done.stderr == f"bodylog: {path}: {text}\n"


@LINUX
def test_commands_refuse_results_after_a_disk_error(tmp_path: Path) -> None:
    """Simulated by truncating another file: the log's own size does not change."""
    other = tmp_path / "other"
    other.write_bytes(b"x" * 100_000)
    done = _run(DISK, str(other), "info", str(FOLDER / "none.mcap"))
    assert done.returncode == 65 and "could not be read" in done.stderr.splitlines()[-1]

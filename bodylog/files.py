"""Files that are either whole or absent: written beside, synced, renamed."""

import hashlib
import mmap
import os
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle
from pathlib import Path

from .errors import UsageError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path beside `path` to write to; on success it is synced and takes `path`'s place, on failure it is removed.

    UsageError when `path` is a folder or in none.
    """
    if path.is_dir():
        raise UsageError(f"{path}: is a folder; give the name of a file with -o")
    if not path.parent.is_dir():
        raise UsageError(f"{path}: there is no folder {path.parent}; type: mkdir -p {path.parent}")
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    beside.unlink(missing_ok=True)  # of a process that was killed, whose number this one has
    try:
        yield beside
        sync(beside)
        os.replace(beside, path)
        sync(path.parent)
    finally:
        beside.unlink(missing_ok=True)


def sync(path: Path) -> None:
    """Ask the kernel to put `path` (file or folder) on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sha256(path: Path) -> str:
    """Hex digest of a file, or of a folder's files in name order."""
    digest = hashlib.sha256()
    for piece in pieces(path, 1 << 20):
        digest.update(piece)
    return digest.hexdigest()


def pieces(path: Path, size: int) -> Iterator[memoryview]:
    """The bytes of a file, or of a folder's files in name order, `size` at a time; of a file only the last is shorter.

    Two buffers take turns: a piece is valid until the next but one is asked for. Each begins at a page of memory.
    """
    buffers = cycle([memoryview(mmap.mmap(-1, size)) for _ in range(2)])
    for part in sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]:
        with part.open("rb") as stream:
            while count := stream.readinto(buffer := next(buffers)):
                yield buffer[:count]

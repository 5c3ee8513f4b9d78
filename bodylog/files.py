"""Files that are either whole or absent: written beside, synced, renamed."""

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

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
    for part in sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]:
        with part.open("rb") as stream:
            _feed(digest, stream)
    return digest.hexdigest()


def _feed(digest: "hashlib._Hash", stream: BinaryIO) -> None:
    while block := stream.read(1 << 20):
        digest.update(block)

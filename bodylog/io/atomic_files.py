"""Files that appear whole or not at all: written beside, synced, renamed."""

import errno
import mmap
import os
import select
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import LogError, OutputError, WriteError
from . import temporary

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of writing that no reading raises."""

_PIECE = 4 << 20


@contextmanager
def replace_atomically(path: Path) -> Iterator[Path]:
    """An empty file beside `path` to write to; on success
    it is synced and replaces `path`, else it is removed.

    A symlink's target is replaced, or created; permissions are kept. Left-overs of killed runs in
    the folder are removed first. OutputError when `path` has no folder, is not a file, or is not
    writable; WriteError when the disk is full or fails.
    """
    path = require_writable(path)
    try:
        with temporary.create_temporary_file(path.parent) as beside:
            yield beside
            if path.exists():
                beside.chmod(path.stat().st_mode & 0o7777)
            sync_to_disk(beside)
            os.replace(beside, path)
            sync_to_disk(path.parent)
    except OSError as problem:
        ours = str(problem.filename).endswith(temporary.PART)
        failed = problem.errno in FULL or (
            problem.errno == errno.EIO and (ours or problem.filename is None)
        )
        if not (failed or ours or problem.errno == errno.EROFS):
            raise
        text = f"{path}: {problem.strerror}; give another name with -o"
        raise (WriteError if failed else OutputError)(text) from problem


def write_text_atomically(path: Path, text: str, errors: str = "strict") -> None:
    """Write a file of UTF-8 with `replace_atomically`."""
    with replace_atomically(path) as beside:
        beside.write_text(text, encoding="utf-8", errors=errors, newline="\n")


def require_writable(path: Path, folder: bool = False) -> Path:
    """The file of an output, behind symlinks; OutputError if it is impossible or protected.

    For a `folder`, which may not exist yet: whether files may be written into it.
    """
    if path.is_symlink() and (folder or path.is_file() or not path.exists()):
        # /dev/stdout has no target path
        path = _resolve_symlink(path)
    if folder:
        place = next(one for one in (path, *path.absolute().parents) if one.exists())
        if not os.access(place, os.W_OK | os.X_OK):
            raise OutputError(f"{path}: is write-protected; give another folder")
        return path
    if path.exists() and not path.is_file():
        raise OutputError(
            f"{path}: is a {'folder' if path.is_dir() else 'device'}; give the name of a "
            "file with -o"
        )
    if not path.parent.is_dir():
        raise OutputError(f"{path}: there is no folder {path.parent}; type: mkdir -p {path.parent}")
    if not all(os.access(place, os.W_OK) for place in (path, path.parent) if place.exists()):
        raise OutputError(f"{path}: is write-protected; give another name with -o")
    return path


def _resolve_symlink(link: Path) -> Path:
    """A symlink's target; OutputError for an endless chain of links."""
    path = Path(os.path.realpath(link))
    if path.is_symlink():
        raise OutputError(f"{link}: is a link that leads back to itself; give another name with -o")
    return path


def ensure_dir(path: Path) -> Path:
    """`path` as a folder, created if missing; OutputError if it or its parent is a file."""
    try:
        Path(os.path.realpath(path)).mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise OutputError(f"{path}: a file is in its place; give the name of a folder") from None
    except OSError as problem:
        kind = WriteError if problem.errno in (*FULL, errno.EIO) else OutputError
        raise kind(f"{path}: {problem.strerror}; give the name of another folder") from None
    return path


def sync_to_disk(path: Path) -> None:
    """Flush `path` (file or folder) to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


PATIENCE = 20.0
"""Seconds to wait for the content of a pipe: nobody may write to it."""


def read_limited_text(path: Path, most: int) -> str:
    """The UTF-8 text of a file or pipe; OSError beyond `most` bytes, or when it does not end.

    Waits PATIENCE s for a pipe that nobody writes to.
    """
    data = bytearray()
    until = time.monotonic() + PATIENCE
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        ready = select.poll()
        ready.register(handle, select.POLLIN)
        while len(data) <= most:
            if not ready.poll(max(0.0, until - time.monotonic()) * 1000.0):
                raise OSError(
                    errno.ETIMEDOUT, f"a pipe that did not come to its end in {PATIENCE:g} s"
                )
            with suppress(BlockingIOError):
                piece = os.read(handle, most + 1 - len(data))
                if not piece:
                    return data.decode()
                data += piece
    finally:
        os.close(handle)
    raise OSError(errno.EFBIG, f"more than {most} bytes")


def is_archive(path: Path) -> bool:
    """Whether this is a .npz, by its name or by its first bytes."""
    if path.suffix == ".npz" or not path.is_file():
        return path.suffix == ".npz"
    with path.open("rb") as stream:
        return stream.read(4) == b"PK\x03\x04"


def require_regular(path: Path) -> None:
    """LogError for a pipe or device: it can be read only once, and opening it may block."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise LogError(
            f"{path}: is a pipe or device, and the input is read twice; save it to a file first"
        )


def hash_files(*paths: Path) -> str:
    """Hex digest of files one after another; of a folder, its files in name order."""
    from hashlib import sha256

    digest = sha256()
    for path in paths:
        for piece in read_pieces(path):
            digest.update(piece)
    return digest.hexdigest()


def read_pieces(path: Path) -> Iterator[memoryview]:
    """The bytes of a file, or of a folder's files in name order, a piece
    at a time, each at a page of memory and valid until the next.
    """
    require_regular(path)
    buffer = memoryview(mmap.mmap(-1, _PIECE))
    for part in sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]:
        with part.open("rb", buffering=0) as stream:
            while size := stream.readinto(buffer):
                yield buffer[:size]

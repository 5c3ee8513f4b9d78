"""Temporary files and folders: named like no other, locked while they live, removed whatever ends the process."""

import _thread
import fcntl
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from ..runtime import signals

PART = ".bodylog.part"
"""How the names of what is half-written end."""
SCRATCH = "bodylog-"
"""How the names of scratch folders begin."""
FOREIGN_S = 86400.0
"""What another machine left, whose locks may not be seen here, is removed after that long without a write."""

_BOOT = Path("/proc/sys/kernel/random/boot_id")
_live: set[Path] = set()
_registry = _thread.allocate_lock()


@contextmanager
def file(folder: Path) -> Iterator[Path]:
    """An empty file in `folder`, locked; removed at the end if still there. What killed runs left goes first."""
    remove_stale(folder, f".*{PART}")
    with _claimed(lambda token: folder / f".{token}{PART}", _make_file) as path:
        yield path


@contextmanager
def scratch(folder: Path | None = None) -> Iterator[Path]:
    """An empty folder, locked, in `folder` or where temporary files go; removed at the end with what is in it."""
    if folder is None:
        folder = _scratches()
        remove_killed()
        name: Callable[[str], str] = f"{SCRATCH}{{}}".format
    else:
        remove_stale(folder, f".*{PART}")
        name = f".{{}}{PART}".format
    with _claimed(lambda token: folder / name(token), _make_folder) as path:
        yield path


def remove_stale(folder: Path, pattern: str) -> None:
    """Remove this user's files and folders of that pattern that nobody holds and nobody on another machine may hold."""
    for left in folder.glob(pattern):
        with suppress(OSError), try_lock(left) as ours:
            if ours and _ours(left):
                _remove(left)


def remove_killed(*folders: Path) -> None:
    """Remove what processes that were killed left: half-written files in `folders`, and scratch folders."""
    for folder in folders:
        remove_stale(folder, f".*{PART}")
    remove_stale(_scratches(), f"{SCRATCH}{'[0-9a-f]' * 8}-{'[0-9a-f]' * 16}")  # users call their own folders so, too


@contextmanager
def try_lock(path: Path) -> Iterator[bool]:
    """Lock a file or folder as long as this process lives and the `with` lasts; False where it is another's."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        yield _lock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    finally:
        os.close(handle)


def sweep() -> None:
    """Remove everything temporary of this process, for it ends: nothing further can be made."""
    _registry.acquire(timeout=0.2)  # never given back
    for path in tuple(_live):
        with suppress(OSError):
            _remove(path)


@cache
def machine() -> str:
    """Eight hex digits that are the same for all whose locks are seen here: processes and containers of one kernel."""
    with suppress(OSError):
        return _BOOT.read_text()[:8]
    from zlib import crc32

    return f"{crc32(os.uname().nodename.encode()):08x}"


@contextmanager
def _claimed(name: Callable[[str], Path], make: Callable[[Path], int | None]) -> Iterator[Path]:
    """Something made and locked before anybody took it for a killed run's; known to `sweep` before it is there."""
    while True:
        path = name(f"{machine()}-{os.urandom(8).hex()}")
        with _registry:
            _live.add(path)
        try:
            handle = make(path)
            if handle is None:
                continue
            try:
                _lock(handle, fcntl.LOCK_EX)
                if not _same(path, handle):
                    continue
                yield path
                return
            finally:
                os.close(handle)
        finally:
            with suppress(OSError):
                _remove(path)
            _live.discard(path)


def _scratches() -> Path:
    """The folder of scratch folders."""
    from tempfile import gettempdir

    return Path(gettempdir())


def _make_folder(path: Path) -> int | None:
    """A handle on it; None where it was taken away before there was one."""
    path.mkdir(0o700)
    with suppress(FileNotFoundError):
        return os.open(path, os.O_RDONLY)
    return None


def _make_file(path: Path) -> int:
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)


def _same(path: Path, handle: int) -> bool:
    try:
        return path.stat().st_ino == os.fstat(handle).st_ino
    except FileNotFoundError:
        return False


def _lock(handle: int, how: int) -> bool:
    """Whether it is locked now; nothing is where files cannot be locked, so there nobody takes any away."""
    try:
        fcntl.flock(handle, how)
        return True
    except OSError:
        return False


def _ours(path: Path) -> bool:
    found = path.lstat()
    here = machine() in path.name or time.time() - found.st_mtime > FOREIGN_S
    return here and found.st_uid == os.geteuid()


def _remove(path: Path) -> None:
    """Without a further import: while another thread is importing that would wait for it."""
    if path.is_dir() and not path.is_symlink():
        for base, folders, files in os.walk(path, topdown=False):
            for name in (*files, *(name for name in folders if os.path.islink(os.path.join(base, name)))):
                os.unlink(os.path.join(base, name))
            os.rmdir(base)
    else:
        path.unlink()


signals.at_end.append(sweep)

"""Temporary files and folders: unique, locked while in use, removed however the process ends."""

import _thread
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from ..runtime import signals

PART = ".bodylog.part"
"""Suffix of half-written files."""
SCRATCH = "bodylog-"
"""Prefix of scratch folders."""
FOREIGN_S = 86400.0
"""Left-overs of another machine, whose locks may be
invisible here, are removed after so many s without a write.
"""
_BOOT = Path("/proc/sys/kernel/random/boot_id")
_live: set[Path] = set()
_registry = _thread.allocate_lock()
try:
    import fcntl
except ImportError:
    # Windows: nothing is locked, and so nothing that another process may hold is removed
    fcntl = None  # type: ignore[assignment]


@contextmanager
def create_temporary_file(folder: Path) -> Iterator[Path]:
    """An empty, locked file in `folder`, removed at the end
    if it exists; removes killed runs' left-overs first.
    """
    remove_stale(folder, f".*{PART}")
    with _create_and_lock(lambda token: folder / f".{token}{PART}", _make_file) as path:
        yield path


@contextmanager
def create_scratch_folder(folder: Path | None = None) -> Iterator[Path]:
    """An empty, locked folder in `folder` or the
    default place; removed at the end with its content.
    """
    if folder is None:
        folder = _scratch_parent()
        remove_killed()
        name: Callable[[str], str] = f"{SCRATCH}{{}}".format
    else:
        remove_stale(folder, f".*{PART}")
        name = f".{{}}{PART}".format
    with _create_and_lock(lambda token: folder / name(token), _make_folder) as path:
        yield path


def remove_stale(folder: Path, pattern: str) -> None:
    """Remove this user's files and folders of that pattern
    that no process holds, here or on another machine.
    """
    for left in folder.glob(pattern):
        with suppress(OSError), try_lock(left) as ours:
            if ours and _is_own_temporary(left):
                _remove_path(left)


def remove_killed(*folders: Path) -> None:
    """Remove left-overs of killed processes: half-written files in `folders`, scratch folders."""
    for folder in folders:
        remove_stale(folder, f".*{PART}")
    # users may have folders of this name
    remove_stale(_scratch_parent(), f"{SCRATCH}{'[0-9a-f]' * 8}-{'[0-9a-f]' * 16}")


@contextmanager
def try_lock(path: Path) -> Iterator[bool]:
    """Lock a file or folder for the `with` block, at most
    for this process's life; False if another holds it.
    """
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    try:
        yield lock_handle(handle, wait=False)
    finally:
        os.close(handle)


def remove_temporary_files() -> None:
    """Remove everything temporary of this process, which is ending: nothing more can be created."""
    _registry.acquire(timeout=0.2)  # never released
    for path in tuple(_live):
        with suppress(OSError):
            _remove_path(path)


@cache
def machine_id() -> str:
    """Eight hex digits that identify the kernel, and so all
    processes and containers whose locks are visible here.
    """
    with suppress(OSError):
        return _BOOT.read_text()[:8]
    from socket import gethostname
    from zlib import crc32

    return f"{crc32(gethostname().encode()):08x}"


@contextmanager
def _create_and_lock(
    name: Callable[[str], Path], make: Callable[[Path], int | None]
) -> Iterator[Path]:
    """Create and lock something before anyone can mistake it for a left-over; registered for
    `remove_temporary_files` before.
    """
    while True:
        path = name(f"{machine_id()}-{os.urandom(8).hex()}")
        with _registry:
            _live.add(path)
        try:
            handle = make(path)
            if handle is None:
                continue
            try:
                lock_handle(handle, wait=True)
                if not _is_same_file(path, handle):
                    continue
                yield path
                return
            finally:
                os.close(handle)
        finally:
            with suppress(OSError):
                _remove_path(path)
            _live.discard(path)


def _scratch_parent() -> Path:
    """The parent of scratch folders."""
    from tempfile import gettempdir

    return Path(gettempdir())


def _make_folder(path: Path) -> int | None:
    """An open handle of the new folder; None if it was removed first."""
    path.mkdir(0o700)
    with suppress(FileNotFoundError):
        return os.open(path, os.O_RDONLY)
    return None


def _make_file(path: Path) -> int:
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)


def _is_same_file(path: Path, handle: int) -> bool:
    try:
        return path.stat().st_ino == os.fstat(handle).st_ino
    except FileNotFoundError:
        return False


def _is_own_temporary(path: Path) -> bool:
    found = path.lstat()
    here = machine_id() in path.name or time.time() - found.st_mtime > FOREIGN_S
    return here and found.st_uid == (os.geteuid() if hasattr(os, "geteuid") else 0)


def _remove_path(path: Path) -> None:
    """Remove without further imports, which would wait for a thread that is importing."""
    if path.is_dir() and not path.is_symlink():
        for base, folders, files in os.walk(path, topdown=False):
            for name in (
                *files,
                *(name for name in folders if os.path.islink(os.path.join(base, name))),
            ):
                os.unlink(os.path.join(base, name))
            os.rmdir(base)
    else:
        path.unlink()


signals.at_end.append(remove_temporary_files)


def lock_handle(handle: int, wait: bool) -> bool:
    """Whether the file or folder of an open handle is now
    locked; False where it cannot be, or another holds it.
    """
    if fcntl is None:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True

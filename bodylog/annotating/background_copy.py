"""Read a log once in the background to digest it and copy its unchanged part."""

import hashlib
import os
import struct
import sys
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from pathlib import Path
from threading import Event

from ..errors import LogError
from ..io.atomic_files import iter_mapped
from ..logs.episode_files import files_of

_PIECE = 8 << 20
_AHEAD = 4
"""Bytes read at once, and how many such pieces the copy may be ahead of the digest."""

_BLOCK = 4096
_FICLONERANGE = 0x4020940D
"""Linux ioctl for two files to share a range of
blocks until one is written (btrfs, XFS, bcachefs, …).
"""

_LONG = 128 << 20
"""Bytes that take about a tenth of a second: shorter copies wait for a free core."""


class Copy:
    """The digest of `source`, and a copy of its first
    `end` bytes to `target`, made within a `with` block.

    The copy is ahead of the digest, which takes longer:
    it can be verified while the rest is digested.
    """

    def __init__(self, source: Path, target: Path | None = None, end: int = 0) -> None:
        """A short log is not copied before `begin`, `copied`
        or `digest`; without `target` nothing is copied.
        """
        self._source = source
        self._target = target
        self._end = end
        self._size = 0 if target is None else source.stat().st_size
        self._begun, self._stopped, self._pool = Event(), Event(), ThreadPoolExecutor(1)
        self._digest = _Digest()
        if target is None or self._size > _LONG:
            self.begin()

    def __enter__(self) -> "Copy":
        """Start the copy."""
        try:
            self._copy = self._pool.submit(self._read)
        except BaseException:  # interrupted while the thread starts: it would wait forever
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Stop after the current piece, if it is not done."""
        self._stopped.set()
        self.begin()
        self._pool.shutdown()
        self._digest.close()

    def begin(self) -> None:
        """Start now if still waiting: a core is free."""
        self._begun.set()

    def copied(self) -> None:
        """Wait until all is read and the copy is made;
        LogError when a copied file changed its size.
        """
        self.begin()
        self._copy.result()

    def digest(self) -> str:
        """Hex SHA-256 of the source, after reading and
        copying; LogError when a copied file changed its size.
        """
        self.copied()
        return self._digest.hex()

    def _read(self) -> None:
        self._begun.wait()
        if self._target is None:
            self._pass(files_of(self._source), None)
            return
        target = _Target(self._target)
        try:
            read = self._pass((self._source,), target)
        finally:
            target.close()
        now = self._source.stat().st_size
        if not self._end <= read == self._size == now:
            grown = f"had {self._size} bytes, but {now} when it was copied"
            raise LogError(f"{self._source}: {grown}; was it still being recorded?")

    def _pass(self, parts: Iterable[Path], target: "_Target | None") -> int:
        """Digest and copy; returns how many bytes were read. Shared bytes are not written."""
        read = 0
        shared = 0 if target is None else target.share(self._source, self._end)
        for part in parts:
            for piece, drop in iter_mapped(part, _PIECE):
                if self._stopped.is_set():
                    raise CancelledError
                self._digest.add(piece, drop)
                if target is not None:
                    low, high = max(0, shared - read), max(0, self._end - read)
                    target.write(piece[low:high], read + low)
                read += len(piece)
        return read


class _Digest:
    """A SHA-256 that a thread computes, by up to `_AHEAD` pieces behind what is added."""

    def __init__(self) -> None:
        self._sha256, self._pool = hashlib.sha256(), ThreadPoolExecutor(1)
        self._behind: deque[Future[None]] = deque()

    def add(self, piece: memoryview, drop: Callable[[], None]) -> None:
        """Digest a piece after those before it, then drop its pages."""
        if len(self._behind) == _AHEAD:
            self._behind.popleft().result()
        self._behind.append(self._pool.submit(self._update, piece, drop))

    def hex(self) -> str:
        """The digest of all pieces."""
        for done in self._behind:
            done.result()
        return self._sha256.hexdigest()

    def close(self) -> None:
        """Wait for the thread."""
        self._pool.shutdown()

    def _update(self, piece: memoryview, drop: Callable[[], None]) -> None:
        self._sha256.update(piece)
        drop()


class _Target:
    """A file written past the page cache if its disk can, to leave the cache to readers."""

    def __init__(self, path: Path) -> None:
        self._plain = os.open(path, os.O_WRONLY)
        try:
            self._direct: int | None = os.open(path, os.O_WRONLY | os.O_DIRECT)
        except (OSError, AttributeError):
            self._direct = None

    def share(self, source: Path, end: int) -> int:
        """Share the first `end` bytes with `source` in whole
        blocks if the disk can; returns how many are shared.
        """
        size = end // _BLOCK * _BLOCK
        if sys.platform != "linux" or not size:
            return 0
        import fcntl

        with source.open("rb") as stream:
            try:
                fcntl.ioctl(
                    self._plain, _FICLONERANGE, struct.pack("=qQQQ", stream.fileno(), 0, size, 0)
                )
            except OSError:
                return 0
        return size

    def close(self) -> None:
        """Close the file."""
        for handle in (self._plain, self._direct):
            if handle is not None:
                os.close(handle)

    def write(self, piece: memoryview, at: int) -> None:
        """Write a piece at byte `at`: whole blocks directly
        to the disk, the remainder through the cache.
        """
        whole = 0 if self._direct is None else len(piece) // _BLOCK * _BLOCK
        done = 0
        while done < len(piece):
            if self._direct is not None and done < whole:
                done += os.pwrite(self._direct, piece[done:whole], at + done)
            else:
                done += os.pwrite(self._plain, piece[done:], at + done)

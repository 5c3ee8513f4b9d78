"""Read a log once in the background to digest it and copy its unchanged part."""

import fcntl
import hashlib
import os
import struct
import sys
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from pathlib import Path
from threading import Event

from ..errors import LogError
from ..io.atomic_files import iter_mapped
from ..logs.episode_files import files_of

_PIECE = 16 << 20
_BLOCK = 4096
_FICLONERANGE = 0x4020940D
"""Linux ioctl for two files to share a range of blocks until one is written (btrfs, XFS, bcachefs, …)."""

_LONG = 128 << 20
"""Bytes that take about a tenth of a second: shorter copies wait for a free core."""


class Copy:
    """The digest of `source`, and a copy of its first `end` bytes to `target`, made within a `with` block."""

    def __init__(self, source: Path, target: Path | None = None, end: int = 0) -> None:
        """A short log is not copied before `begin` or `digest`; without `target` nothing is copied."""
        self._source, self._target, self._end = source, target, end
        self._size = 0 if target is None else source.stat().st_size
        self._begun, self._stopped, self._pool = Event(), Event(), ThreadPoolExecutor(1)
        if target is None or self._size > _LONG:
            self.begin()

    def __enter__(self) -> "Copy":
        """Start the copy."""
        try:
            self._digest = self._pool.submit(self._read)
        except BaseException:  # interrupted while the thread starts: it would wait forever
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Stop after the current piece, if it is not done."""
        self._stopped.set()
        self.begin()
        self._pool.shutdown()

    def begin(self) -> None:
        """Start now if still waiting: a core is free."""
        self._begun.set()

    def digest(self) -> str:
        """Hex SHA-256 of the source, after reading and copying; LogError when a copied file changed its size."""
        self.begin()
        return self._digest.result()

    def _read(self) -> str:
        self._begun.wait()
        if self._target is None:
            return self._pass(None)[0]
        target = _Target(self._target)
        try:
            digest, read = self._pass(target)
            target.wait()
        finally:
            target.close()
        now = self._source.stat().st_size
        if not self._end <= read == self._size == now:
            grown = f"had {self._size} bytes, but {now} when it was copied"
            raise LogError(f"{self._source}: {grown}; was it still being recorded?")
        return digest

    def _pass(self, target: "_Target | None") -> tuple[str, int]:
        """The digest and the number of bytes; each piece is written while it is digested, unless it is shared."""
        digest, read = hashlib.sha256(), 0
        shared = 0 if target is None else target.share(self._source, self._end)
        parts = files_of(self._source) if target is None else (self._source,)
        for piece in (piece for part in parts for piece in iter_mapped(part, _PIECE)):
            if self._stopped.is_set():
                raise CancelledError
            if target is not None:
                low, high = max(0, shared - read), max(0, self._end - read)
                target.write(piece[low:high], read + low)
            digest.update(piece)
            read += len(piece)
        return digest.hexdigest(), read


class _Target:
    """A file written in the background, past the page cache if its disk can, to leave the cache to readers."""

    def __init__(self, path: Path) -> None:
        self._plain = os.open(path, os.O_WRONLY)
        try:
            self._direct: int | None = os.open(path, os.O_WRONLY | os.O_DIRECT)
        except (OSError, AttributeError):
            self._direct = None
        self._pool = ThreadPoolExecutor(1)
        self._writing: Future[None] | None = None

    def share(self, source: Path, end: int) -> int:
        """Share the first `end` bytes with `source` in whole blocks if the disk can; returns how many are shared."""
        size = end // _BLOCK * _BLOCK
        if sys.platform != "linux" or not size:
            return 0
        with source.open("rb") as stream:
            try:
                fcntl.ioctl(self._plain, _FICLONERANGE, struct.pack("=qQQQ", stream.fileno(), 0, size, 0))
            except OSError:
                return 0
        return size

    def write(self, piece: memoryview, at: int) -> None:
        """Start to write a piece, if not empty, at byte `at` after the previous one is written."""
        self.wait()
        self._writing = self._pool.submit(self._write, piece, at)

    def wait(self) -> None:
        """Wait until all is written; OSError if that fails."""
        if self._writing is not None:
            self._writing.result()

    def close(self) -> None:
        """Close the file."""
        self._pool.shutdown()
        for handle in (self._plain, self._direct):
            if handle is not None:
                os.close(handle)

    def _write(self, piece: memoryview, at: int) -> None:
        """Write whole blocks directly to the disk, the remainder through the cache."""
        whole = 0 if self._direct is None else len(piece) // _BLOCK * _BLOCK
        done = 0
        while done < len(piece):
            if self._direct is not None and done < whole:
                done += os.pwrite(self._direct, piece[done:whole], at + done)
            else:
                done += os.pwrite(self._plain, piece[done:], at + done)

"""Read a log once in the background to digest it and copy its unchanged part."""

import hashlib
import os
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from itertools import chain
from pathlib import Path
from threading import Event

from ..errors import LogError
from ..io.atomic_files import read_pieces
from ..logs.formats import files_of

_BLOCK = 4096


class Copy:
    """The digest of `source`, and a copy of its first
    `end` bytes to `target`, made within a `with` block.

    Without `target` nothing is copied.
    """

    def __init__(self, source: Path, target: Path | None = None, end: int = 0) -> None:
        """A thread begins when the block is entered."""
        self._source = source
        self._target = target
        self._end = end
        self._size = 0 if target is None else source.stat().st_size
        self._stopped = Event()
        self._pool = ThreadPoolExecutor(1)

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
        self._pool.shutdown()

    def digest(self) -> str:
        """Hex SHA-256 of the source, after reading and
        copying; LogError when a copied file changed its size.
        """
        return self._copy.result()

    def _read(self) -> str:
        sha256 = hashlib.sha256()
        read = 0
        with ExitStack() as opened:
            hashing = opened.enter_context(ThreadPoolExecutor(1))
            parts = (self._source,) if self._target else files_of(self._source)
            target = opened.enter_context(_CopyTarget(self._target)) if self._target else None
            for piece in chain.from_iterable(map(read_pieces, parts)):
                if self._stopped.is_set():
                    raise CancelledError
                digested = hashing.submit(sha256.update, piece)
                if target is not None:
                    target.write(piece[: max(0, self._end - read)], read)
                digested.result()
                read += len(piece)
        if self._target is not None:
            now = self._source.stat().st_size
            if not self._end <= read == self._size == now:
                grown = f"had {self._size} bytes, but {now} when it was copied"
                raise LogError(f"{self._source}: {grown}; was it still being recorded?")
        return sha256.hexdigest()


class _CopyTarget(ExitStack):
    """A file written past the page cache if its disk can, to leave the cache to readers."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._plain = os.open(path, os.O_WRONLY)
        self.callback(os.close, self._plain)
        self._direct = self._plain
        with suppress(OSError, AttributeError):
            self._direct = os.open(path, os.O_WRONLY | os.O_DIRECT)
            self.callback(os.close, self._direct)

    def write(self, piece: memoryview, at: int) -> None:
        """Write a piece at byte `at`: whole blocks directly
        to the disk, the remainder through the cache.
        """
        whole = 0 if at % _BLOCK else len(piece) // _BLOCK * _BLOCK
        done = 0
        while done < len(piece):
            if done < whole:
                done += os.pwrite(self._direct, piece[done:whole], at + done)
            else:
                done += os.pwrite(self._plain, piece[done:], at + done)

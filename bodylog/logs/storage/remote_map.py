"""A remote file as a memory map: a sparse local file, filled block by block on request."""

import mmap
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from weakref import finalize

from ...io.temporary import create_scratch_folder

_BLOCK = 1 << 18
_ENDS = 1 << 20

Read = Callable[[int, int], bytes]
"""Reads the bytes of a remote file from one offset to before another."""


class RemoteMap(mmap.mmap):
    """A memory map of a remote file; call `ensure_local` before access."""

    present: set[int]
    remote: Read
    lock: Lock
    handle: int

    def ensure_local(self, start: int, end: int) -> None:
        """Fetch the missing blocks between the bytes `start` and `end` in few requests."""
        with self.lock:
            wanted = [
                block
                for block in range(start // _BLOCK, -(-end // _BLOCK))
                if block not in self.present
            ]
            for first, last in _consecutive_runs(wanted):
                low = first * _BLOCK
                high = min((last + 1) * _BLOCK, len(self))
                data = self.remote(low, high)
                if len(data) != high - low:
                    raise OSError(f"{len(data)} bytes arrived where {high - low} were asked for")
                os.pwrite(self.handle, data, low)
                self.present.update(range(first, last + 1))


def _consecutive_runs(blocks: list[int]) -> Iterator[tuple[int, int]]:
    first = None
    last = None
    for block in blocks:
        if first is None or last is None or block != last + 1:
            if first is not None and last is not None:
                yield first, last
            first = block
        last = block
    if first is not None and last is not None:
        yield first, last


_MAPPED: dict[Path, tuple[Read, int]] = {}


@contextmanager
def mapped_remote(name: str, size: int, read: Read) -> Iterator[Path]:
    """A path that `mmapped.map_file` maps as a RemoteMap of
    `size` bytes; its head is there to detect its format.
    """
    with create_scratch_folder() as folder:
        path = folder / name
        with path.open("wb") as stream:
            stream.write(read(0, min(size, 64))[:64])
            stream.truncate(size)
        _MAPPED[path] = read, size
        try:
            yield path
        finally:
            del _MAPPED[path]


def remote_map_of(path: Path) -> RemoteMap | None:
    """The map of a path from `mapped_remote`, with its ends fetched; None for any other path."""
    if path not in _MAPPED:
        return None
    read, size = _MAPPED[path]
    handle = os.open(path, os.O_RDWR)
    found = RemoteMap(handle, 0, access=mmap.ACCESS_READ)
    finalize(found, os.close, handle)
    found.present = set()
    found.remote = read
    found.lock = Lock()
    found.handle = handle
    found.ensure_local(0, min(_BLOCK, size))
    found.ensure_local(max(0, size - _ENDS), size)
    return found

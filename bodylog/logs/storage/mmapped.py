"""Memory-mapped files whose pages are dropped after
use, so that resident memory does not grow with the log.
"""

import mmap
from pathlib import Path

import numpy as np

from ...errors import BodylogError, LogError
from ..records import Array
from .remote_map import RemoteMap, remote_map_of

_ADVICE = hasattr(mmap, "MADV_DONTNEED")
_PAGE = mmap.PAGESIZE
_BEHIND = 32
_AROUND = 2 << 20
"""Images are used a while after they were read; and touching one page loads its neighbours."""


def map_file(path: Path) -> memoryview:
    """Map a file that is not empty; only pages that are touched are read."""
    if (remote := remote_map_of(path)) is not None:
        return memoryview(remote)
    with path.open("rb") as stream:
        found = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    if _ADVICE:
        found.madvise(mmap.MADV_RANDOM)
    return memoryview(found)


def is_mapped(data: Array) -> bool:
    """Whether bytes (n,) belong to a mapped file, so that they stay valid while they are held."""
    return isinstance(getattr(data.base, "obj", None), mmap.mmap)


def check_untruncated(data: memoryview, path: Path, problem: BaseException | None = None) -> None:
    """LogError when the mapped file was truncated during
    reading and `problem`, if any, may follow from that.
    """
    if not isinstance(data.obj, mmap.mmap) or not isinstance(problem, BodylogError | None):
        return
    if (left := data.obj.size()) < len(data):
        text = f"had {len(data)} bytes, but {left} while it was read"
        raise LogError(f"{path}: {text}; give it when nobody writes to it") from problem


def advise_sequential(data: memoryview, start: int, end: int, alone: bool = False) -> None:
    """Tell the kernel that all bytes between two will be read in order.

    The page cache then holds the file in large pieces, which are mapped at once. With `alone` only
    these bytes are requested: readahead would load some megabytes beyond them.
    """
    ensure_local(data, start, end)
    low = start // _PAGE * _PAGE
    high = min(-(-end // _PAGE) * _PAGE, len(data))
    if _ADVICE and high > low and isinstance(data.obj, mmap.mmap):
        data.obj.madvise(mmap.MADV_WILLNEED if alone else mmap.MADV_SEQUENTIAL, low, high - low)


def ensure_local(data: memoryview, start: int, end: int) -> None:
    """Fetch the bytes between two of a remote file; does nothing for a local file."""
    if isinstance(data.obj, RemoteMap):
        data.obj.ensure_local(start, min(end, len(data)))


def is_zero(data: memoryview, start: int, end: int) -> bool:
    """Whether all bytes between two are 0, as in preallocated space; drops their pages if so."""
    advise_sequential(data, start, end)
    if np.frombuffer(data, np.uint8, end - start, start).any():
        return False
    drop_pages(data, start, end)
    return True


def drop_pages(data: memoryview, start: int, end: int) -> None:
    """Drop the pages between two bytes of a mapped
    file, and those well before; access maps them again.
    """
    behind = max(_AROUND, _BEHIND * (end - start))
    low = max(0, start - behind) // _PAGE * _PAGE
    high = min(-(-end // _PAGE) * _PAGE, len(data))
    if _ADVICE and high > low and type(data.obj) is mmap.mmap:
        data.obj.madvise(mmap.MADV_DONTNEED, low, high - low)
        data.obj.madvise(mmap.MADV_RANDOM, low, high - low)

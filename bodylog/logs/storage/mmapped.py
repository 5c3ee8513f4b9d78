"""Files mapped into memory, and pages let go again, so that what is resident does not grow with the log."""

import mmap
from pathlib import Path

import numpy as np

from ...errors import BodylogError, LogError
from ..records import Array
from .remote_map import RemoteMap, remote_map_of

_ADVICE = hasattr(mmap, "MADV_DONTNEED")
_PAGE = mmap.PAGESIZE
_BEHIND, _AROUND = 32, 2 << 20
"""Pictures are looked at a while after they were handed out; and a page that is touched brings its neighbours along."""


def mapped(path: Path) -> memoryview:
    """The bytes of a file that is not empty, read as they are touched, and no more than is touched."""
    if (remote := remote_map_of(path)) is not None:
        return memoryview(remote)
    with path.open("rb") as stream:
        found = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    if _ADVICE:
        found.madvise(mmap.MADV_RANDOM)
    return memoryview(found)


def is_mapped(data: Array) -> bool:
    """Whether bytes (n,) are a mapped file's, which stay what they are for whoever holds them."""
    return isinstance(getattr(data.base, "obj", None), mmap.mmap)


def check_untruncated(data: memoryview, path: Path, problem: BaseException | None = None) -> None:
    """LogError when the mapped file was cut while it was read, and nothing worse than what follows from it happened."""
    if not isinstance(data.obj, mmap.mmap) or not isinstance(problem, BodylogError | None):
        return
    if (left := data.obj.size()) < len(data):
        said = f"had {len(data)} bytes, but {left} while it was read"
        raise LogError(f"{path}: {said}; give it once nobody writes to it any more") from problem


def advise_sequential(data: memoryview, start: int, end: int, alone: bool = False) -> None:
    """Have the file read ahead of where it is touched between two bytes: all of that is about to be, in order.

    Read ahead so, a file is kept in large pieces, which are mapped at once; asked for by hand, page by page. What is
    wanted `alone` is asked for by hand: to read ahead would bring some megabytes that lie behind it along.
    """
    ensure_local(data, start, end)
    low, high = start // _PAGE * _PAGE, min(-(-end // _PAGE) * _PAGE, len(data))
    if _ADVICE and high > low and isinstance(data.obj, mmap.mmap):
        data.obj.madvise(mmap.MADV_WILLNEED if alone else mmap.MADV_SEQUENTIAL, low, high - low)


def ensure_local(data: memoryview, start: int, end: int) -> None:
    """Have the bytes between two of a remote file there before they are touched; a file of this machine has its own."""
    if isinstance(data.obj, RemoteMap):
        data.obj.ensure_local(start, min(end, len(data)))


def is_zero(data: memoryview, start: int, end: int) -> bool:
    """Whether all bytes between two are 0, as where a file was given room and never written; their pages are let go."""
    advise_sequential(data, start, end)
    if np.frombuffer(data, np.uint8, end - start, start).any():
        return False
    drop_pages(data, start, end)
    return True


def drop_pages(data: memoryview, start: int, end: int) -> None:
    """Let go of the pages between two bytes of a mapped file and of many before; touching them maps them again."""
    behind = max(_AROUND, _BEHIND * (end - start))
    low, high = max(0, start - behind) // _PAGE * _PAGE, min(-(-end // _PAGE) * _PAGE, len(data))
    if _ADVICE and high > low and type(data.obj) is mmap.mmap:
        data.obj.madvise(mmap.MADV_DONTNEED, low, high - low)
        data.obj.madvise(mmap.MADV_RANDOM, low, high - low)

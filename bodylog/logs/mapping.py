"""Files mapped into memory, and pages let go again, so that what is resident does not grow with the log."""

import mmap
from pathlib import Path

from .sparse import Sparse, sparse

_ADVICE = hasattr(mmap, "MADV_DONTNEED")
_PAGE = mmap.PAGESIZE
_ASKED = 1 << 20
"""Asked for more than a disk reads ahead, the kernel begins with that and leaves the rest to faults, page by page."""
_AROUND = 2 << 20
"""A page that is touched can bring its neighbours along, those before it too: a folio of the page cache at most."""


def mapped(path: Path) -> memoryview:
    """The bytes of a file that is not empty, read as they are touched, and no more than is touched."""
    if (remote := sparse(path)) is not None:
        return memoryview(remote)
    with path.open("rb") as stream:
        found = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    if _ADVICE:
        found.madvise(mmap.MADV_RANDOM)
    return memoryview(found)


def fetch(data: memoryview, start: int, end: int) -> None:
    """Start reading what lies between two bytes of a mapped file: all of it is about to be touched."""
    bring(data, start, end)
    low, high = start // _PAGE * _PAGE, min(-(-end // _PAGE) * _PAGE, len(data))
    if _ADVICE and isinstance(data.obj, mmap.mmap):
        for at in range(low, high, _ASKED):
            data.obj.madvise(mmap.MADV_WILLNEED, at, min(_ASKED, high - at))


def bring(data: memoryview, start: int, end: int) -> None:
    """Have the bytes between two of a remote file there before they are touched; a file of this machine has its own."""
    if isinstance(data.obj, Sparse):
        data.obj.bring(start, min(end, len(data)))


def forget(data: memoryview, start: int, end: int) -> None:
    """Let go of the pages between two bytes of a mapped file and of those before; touching them reads them again."""
    low, high = max(0, start - _AROUND) // _PAGE * _PAGE, min(-(-end // _PAGE) * _PAGE, len(data))
    if _ADVICE and high > low and type(data.obj) is mmap.mmap:
        data.obj.madvise(mmap.MADV_DONTNEED, low, high - low)

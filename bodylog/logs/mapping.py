"""Files mapped into memory, and pages let go again, so that what is resident does not grow with the log."""

import mmap
from pathlib import Path


def mapped(path: Path) -> memoryview:
    """The bytes of a file that is not empty, read as they are touched."""
    with path.open("rb") as stream:
        return memoryview(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ))


def forget(data: memoryview, start: int, end: int) -> None:
    """Let go of the whole pages between two bytes of a mapped file; touching them again reads them again."""
    page = mmap.PAGESIZE
    low, high = -(-start // page) * page, end // page * page
    if high > low and isinstance(data.obj, mmap.mmap) and hasattr(data.obj, "madvise"):
        data.obj.madvise(mmap.MADV_DONTNEED, low, high - low)

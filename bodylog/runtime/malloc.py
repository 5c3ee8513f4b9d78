"""Keep freed memory in the process: requesting it again costs as much as the arithmetic in it."""

import ctypes

_TRIM = -1
_MMAP = -3
_ARENAS = -8
_KEPT = 1 << 28


def tune_malloc() -> None:
    """Make the C library (glibc only) return memory only beyond 256 MB, whatever was set before.

    One arena for all threads lets them reuse each other's memory instead of faulting in new pages.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):
        return
    mallopt(_MMAP, _KEPT)
    mallopt(_TRIM, _KEPT)
    mallopt(_ARENAS, 1)

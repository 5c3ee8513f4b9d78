"""Memory the process got from the system stays with it: getting it anew costs as much as the arithmetic in it."""

import ctypes

_TRIM, _MMAP, _ARENAS = -1, -3, -8
_KEPT = 1 << 28


def tune_malloc() -> None:
    """Have the C library (glibc; others: nothing) give memory back only beyond 256 MB, whatever it was told before.

    One arena for all threads: what one frees the next takes, so they do not each fault in pages of their own.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):
        return
    mallopt(_MMAP, _KEPT)
    mallopt(_TRIM, _KEPT)
    mallopt(_ARENAS, 1)

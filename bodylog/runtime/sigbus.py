"""Replace missing pages of a mapped file (truncated, or
a disk error) by zeros instead of ending the process.
"""

import ctypes
import mmap
import signal
import sys
from typing import Any

_AT = 16
_CODE = 8
_NO_SUCH_BYTE = 2
_MASK = 128 // ctypes.sizeof(ctypes.c_ulong)
_HANDLER = ctypes.CFUNCTYPE(None, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
_FLAGS = 0x22 | 0x10  # private, anonymous, replacing the existing page
_WITH_PLACE = 4


class _Action(ctypes.Structure):
    """Linux' struct sigaction."""

    _fields_ = (
        ("handler", ctypes.c_void_p),
        ("mask", ctypes.c_ulong * _MASK),
        ("flags", ctypes.c_int),
        ("restorer", ctypes.c_void_p),
    )


_kept: list[Any] = []
_pages: list[int] = []


def zeroed_pages() -> int:
    """How many pages were zeroed so far: if the number grew, data read meanwhile may be wrong."""
    return len(_pages)


def install_sigbus_handler() -> None:
    """Let this process survive SIGBUS on mapped files (Linux only)."""
    if sys.platform != "linux" or _kept:
        return
    library = ctypes.CDLL(None)
    library.mmap.restype = ctypes.c_void_p
    place = (ctypes.c_void_p, ctypes.c_size_t)
    library.mmap.argtypes = (*place, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long)
    before = _Action()

    def fill(number: int, about: int, _context: int) -> None:
        page = (ctypes.c_void_p.from_address(about + _AT).value or 0) & -mmap.PAGESIZE
        code = ctypes.c_int.from_address(about + _CODE).value
        mapped = None
        if code == _NO_SUCH_BYTE:
            mapped = library.mmap(page, mmap.PAGESIZE, mmap.PROT_READ, _FLAGS, -1, 0)
            _pages.append(page)
        if mapped != page:  # another fault: it recurs at once, with the default action
            library.sigaction(number, ctypes.byref(before), None)

    _kept.append(_HANDLER(fill))
    action = _Action(handler=ctypes.cast(_kept[0], ctypes.c_void_p), flags=_WITH_PLACE)
    library.sigaction(signal.SIGBUS, ctypes.byref(action), ctypes.byref(before))

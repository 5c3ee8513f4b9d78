"""What is cut off a mapped file, or its disk cannot read, is taken for zeros; else the process would be killed."""

import ctypes
import mmap
import signal
import sys
from typing import Any

_AT, _CODE, _NO_SUCH_BYTE = 16, 8, 2
_MASK = 128 // ctypes.sizeof(ctypes.c_ulong)
_HANDLER = ctypes.CFUNCTYPE(None, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
_FLAGS = 0x22 | 0x10  # private, of no file; in the place of what is there
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
    """How many pages of zeros were put in so far: what was read since there were fewer is not what was written."""
    return len(_pages)


def install_sigbus_handler() -> None:
    """Have this process survive that (Linux; elsewhere nothing)."""
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
        if mapped != page:  # another fault: as before, when it comes again at once
            library.sigaction(number, ctypes.byref(before), None)

    _kept.append(_HANDLER(fill))
    action = _Action(handler=ctypes.cast(_kept[0], ctypes.c_void_p), flags=_WITH_PLACE)
    library.sigaction(signal.SIGBUS, ctypes.byref(action), ctypes.byref(before))

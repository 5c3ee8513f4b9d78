"""The compiled library of the engine: `setup.py` builds
it from the C files of `estimation/`, and ctypes calls it.
"""

import ctypes
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UsageError
from ...types import Array

LIBRARY = Path(__file__).with_name("libkernel.so")
LANES = 8
"""Stretches, or candidates, that the library computes side by side."""


@cache
def load_library() -> ctypes.CDLL:
    """The library, loaded at the first call; threads may
    run its functions side by side, without Python's lock.
    """
    try:
        return ctypes.CDLL(str(LIBRARY))
    except OSError as err:
        raise _unusable_library_error(f"is missing or does not load: {err}") from None


def list_struct_fields(integers: str, numbers: str, arrays: str) -> list[tuple[str, Any]]:
    """The fields of a C struct by their names: int64_t, then double, then pointers."""
    kinds = (integers, ctypes.c_int64), (numbers, ctypes.c_double), (arrays, ctypes.c_void_p)
    return [(name, kind) for names, kind in kinds for name in names.split()]


def bind_kernel_call(
    function: str, record: type[ctypes.Structure], **values: Any
) -> Callable[[], None]:
    """A call of a function with a struct: numbers, and
    arrays of float64 or bool in C's order, or None.

    Arrays are read and written where they are, at each call. MemoryError where it finds no room.
    """
    given = record(
        **{
            name: _array_address(part) if isinstance(part, np.ndarray) else part
            for name, part in values.items()
        }
    )
    given.arrays = values  # they live as long as the struct
    known = getattr(load_library(), function, None)
    size = ctypes.c_int64(ctypes.sizeof(record))

    def called() -> None:
        failed = known(ctypes.byref(given), size) if known else 2
        if failed == 1:
            raise MemoryError(f"{function} finds no room for a stretch of the log")
        if failed:
            raise _unusable_library_error("is of another version")

    return called


def _array_address(array: Array) -> int:
    assert array.dtype in (np.float64, np.bool_) and array.flags.c_contiguous, (
        array.dtype,
        array.strides,
    )
    return int(array.__array_interface__["data"][0])


def _unusable_library_error(why: str) -> UsageError:
    return UsageError(f"the compiled library {why}; type in bodylog's folder: pip install .")

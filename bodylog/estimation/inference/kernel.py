"""The compiled library of the engine: `setup.py` builds it from the C files of `estimation/`, and ctypes calls it."""

import ctypes
from functools import cache
from pathlib import Path

import numpy as np

from ...errors import UsageError
from ...types import Array

LIBRARY = Path(__file__).with_name("libkernel.so")


@cache
def library() -> ctypes.CDLL:
    """The library, loaded at the first call; threads may run its functions side by side, without Python's lock."""
    try:
        return ctypes.CDLL(str(LIBRARY))
    except OSError as err:
        text = f"the compiled library is missing or does not load: {err}; type in bodylog's folder: pip install ."
        raise UsageError(text) from None


def pointer(array: Array | None) -> ctypes.c_void_p:
    """Address of a C-contiguous array of float64 or uint8, or null; the caller keeps the array during the call."""
    if array is None:
        return ctypes.c_void_p()
    assert array.dtype in (np.float64, np.uint8) and array.flags.c_contiguous, (array.dtype, array.strides)
    return ctypes.c_void_p(array.ctypes.data)

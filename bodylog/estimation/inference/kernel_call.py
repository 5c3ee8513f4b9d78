"""Calls of the compiled loops over instants: Numba and
they are imported at the first call alone.
"""

from collections.abc import Callable
from functools import cache, partial
from types import ModuleType
from typing import Any

import numpy as np


@cache
def load_kernels() -> ModuleType:
    """The compiled loops; where no cache of machine code holds them, this compiles them."""
    from . import kernels

    return kernels


def bind_kernel_call(function: str, **values: Any) -> Callable[[], None]:
    """A call of a kernel with numbers and with arrays in
    C's order, of float64 or bool; None for no array.

    Arrays are read and written where they are, at each call.
    """
    kernel = getattr(load_kernels(), function)
    kinds = kernel.nopython_signatures[0].args
    names = kernel.py_func.__code__.co_varnames[: len(kinds)]
    assert values.keys() == set(names), values.keys() ^ set(names)
    given = []
    for name, kind in zip(names, kinds, strict=True):
        value = values[name]
        if (axes := getattr(kind, "ndim", 0)) > 0:
            dtype = np.dtype(str(kind.dtype))
            value = np.empty((0,) * axes, dtype) if value is None else value
            assert value.ndim == axes and value.dtype == dtype and value.flags.c_contiguous, name
        given.append(value)
    return partial(kernel, *given)

"""How kernels.py is compiled: by Numba, whose machine code is kept in a file for the next start."""

import pickle
from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit, types

Function = TypeVar("Function", bound=Callable[..., Any])

OPTIONS = {"nogil": True, "error_model": "numpy"}
"""Threads may run kernels side by side; divisions are IEEE 754's. Sums are not reordered and
products not fused, as `fastmath` is off, so that numbers do not depend on the processor."""
CACHE_ERRORS = (RuntimeError, OSError, EOFError, pickle.UnpicklingError)
"""Numba's where neither the package's nor the user's folder can be written, where the disk is
full, or where a file of the cache is broken."""

whole = types.int64
number = types.float64


def read(axes: int) -> Any:
    """An array of numbers that a kernel reads."""
    return types.Array(types.float64, axes, "C", readonly=True)


def read_flags(axes: int) -> Any:
    """An array of bool that a kernel reads."""
    return types.Array(types.boolean, axes, "C", readonly=True)


def write(axes: int) -> Any:
    """An array of numbers that a kernel writes."""
    return types.Array(types.float64, axes, "C")


def compile_inner(function: Function) -> Function:
    """Compile a function that kernels call, with them."""
    compiled: Function = njit(_nrt=False, **OPTIONS)(function)
    return compiled


def compile_kernel(*arguments: Any) -> Callable[[Function], Function]:
    """Compile a kernel for arguments of these types alone, now, or take it from the cache.

    Where there is no cache, each start compiles.
    """
    signature = types.void(*arguments)

    def compile_function(function: Function) -> Function:
        compiled: Function
        try:
            compiled = njit(signature, cache=True, no_cfunc_wrapper=True, **OPTIONS)(function)
        except CACHE_ERRORS:
            compiled = njit(signature, **OPTIONS)(function)
        return compiled

    return compile_function

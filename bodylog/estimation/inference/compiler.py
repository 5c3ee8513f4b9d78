"""How kernels.py is compiled: by Numba, which keeps the machine code in a file for later starts."""

import logging
from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit, types
from numba.core import event

Function = TypeVar("Function", bound=Callable[..., Any])

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
"""Threads may run kernels side by side, and divisions are IEEE 754's. Without `fastmath` sums are
not reordered and products not fused, so that numbers do not depend on the processor."""
INNER_OPTIONS: dict[str, Any] = {**OPTIONS, "_nrt": False}
"""Without counts of references, which would take a third of a filter's time."""
LOG = logging.getLogger(__name__)
whole = types.int64
number = types.float64


def input_array(axes: int) -> Any:
    """The type of an array of numbers that a kernel reads."""
    return types.Array(types.float64, axes, "C", readonly=True)


def input_flags(axes: int) -> Any:
    """The type of an array of bool that a kernel reads."""
    return types.Array(types.boolean, axes, "C", readonly=True)


def output_array(axes: int) -> Any:
    """The type of an array of numbers that a kernel writes."""
    return types.Array(types.float64, axes, "C")


def compile_inner(function: Function) -> Function:
    """Compile a function that kernels call, with them; it must not allocate arrays."""
    compiled: Function = njit(**INNER_OPTIONS)(function)
    return compiled


def compile_kernel(*arguments: Any) -> Callable[[Function], Function]:
    """Compile a kernel now, for arguments of these types alone, or take it from the cache.

    Without a cache each start compiles.
    """
    signature = types.void(*arguments)

    def compile_function(function: Function) -> Function:
        compiled: Function
        try:
            compiled = njit(signature, cache=True, **OPTIONS)(function)
        except Exception as err:
            # no folder for the cache, a full disk, a broken file: each has its own kind
            compiled = njit(signature, **OPTIONS)(function)
            LOG.warning(
                "%s",
                f"{function.__name__}: its machine code is not kept, so that each start compiles "
                f"it: {err!r}; set NUMBA_CACHE_DIR to a new folder that can be written",
            )
        return compiled

    return compile_function


class CompilationNotice(event.Listener):
    """Logs once that the kernels are compiled, when they are not in the cache."""

    def __init__(self) -> None:
        """Nothing has been compiled yet."""
        self._told = False

    def on_start(self, event: Any) -> None:
        """A function is about to be compiled."""
        if not self._told:
            LOG.warning("bodylog compiles its filter, once: this takes half a minute")
        self._told = True

    def on_end(self, event: Any) -> None:
        """It is compiled."""

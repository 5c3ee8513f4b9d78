"""How kernels.py is compiled: by Numba, which keeps the machine code in a file for later starts."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, TypeVar

from numba import njit, types
from numba.core import event

Function = TypeVar("Function", bound=Callable[..., Any])

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""Threads may run kernels side by side, and divisions are IEEE 754's. Without `fastmath` sums are
not reordered and products not fused, so that numbers do not depend on the processor."""
INNER_OPTIONS: dict[str, Any] = {**OPTIONS, "_nrt": False, "no_cpython_wrapper": True}
"""Without counts of references, which would take a third of a filter's time, and without entries
from Python and C, which would take a tenth of the compilation's."""
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


def record_of(kind: type, *fields: Any) -> Any:
    """The type of a record, a NamedTuple, with fields of these types."""
    if len(set(fields)) == 1:
        return types.NamedUniTuple(fields[0], len(fields), kind)  # type: ignore[no-untyped-call]
    return types.NamedTuple(fields, kind)  # type: ignore[no-untyped-call]


def compile_inner(function: Function) -> Function:
    """Compile a function that kernels call, with them; it must not allocate arrays."""
    compiled: Function = njit(**INNER_OPTIONS)(function)
    return compiled


@dataclass(frozen=True, eq=False)
class Kernel:
    """A function for arguments of the types of its signature alone, not yet compiled."""

    function: Callable[..., None]
    signature: Any

    @cached_property
    def compiled(self) -> Any:
        """The function as machine code, from the cache if it is there; else each start compiles."""
        try:
            return njit(self.signature, cache=True, **OPTIONS)(self.function)
        except Exception as err:
            # no folder for the cache, a full disk, a broken file: each has its own kind
            compiled = njit(self.signature, **OPTIONS)(self.function)
            LOG.warning(
                f"{self.function.__name__}: its machine code is not kept, so that each start "
                f"compiles it: {err!r}; set NUMBA_CACHE_DIR to a new folder that can be written"
            )
            return compiled


def declare_kernel(*arguments: Any) -> Callable[[Callable[..., None]], Kernel]:
    """Make a kernel of a function, for arguments of these types."""
    return partial(Kernel, signature=types.void(*arguments))


class CompilationNotice(event.Listener):
    """Logs once that the kernels are compiled, when they are not in the cache."""

    _logged = False

    def on_start(self, event: Any) -> None:
        """A function is about to be compiled."""
        if not self._logged:
            LOG.warning("bodylog compiles its filter, once: this takes a quarter of a minute")
        self._logged = True

    def on_end(self, event: Any) -> None:
        """It is compiled."""


NOTICE = CompilationNotice()
"""The listener of this process."""

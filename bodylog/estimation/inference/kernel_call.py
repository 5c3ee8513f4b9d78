"""Calls of the compiled loops over instants. Numba and kernels.py are imported by the first call,
so that what estimates nothing does not wait for them.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np

KERNELS = ("weigh_noise_ratios", "filter_instants", "carry_adjoint_back", "carry_information_back")
"""The compiled loops, in the order in which an estimate asks for them."""


@cache
def load_kernel(name: str) -> Any:
    """A compiled loop over instants; its first use on a machine compiles it, and logs a warning."""
    from numba.core.event import install_listener

    from . import kernels
    from .compiler import NOTICE

    with install_listener("numba:compile", NOTICE):
        return getattr(kernels, name).compiled


def load_kernels() -> None:
    """Load every compiled loop, as an installation does, so that no estimate waits for one."""
    for name in KERNELS:
        load_kernel(name)


def bind_kernel_call(function: str, **values: Any) -> Callable[[], None]:
    """A call of a kernel with numbers, and with arrays of
    float64 or bool in C's order, or None for no array.

    Arrays are read and written where they are, at each call.
    """
    kernel = load_kernel(function)
    kinds = kernel.nopython_signatures[0].args
    names = kernel.py_func.__code__.co_varnames[: len(kinds)]
    assert values.keys() == set(names), values.keys() ^ set(names)
    arguments = []
    for name, kind in zip(names, kinds, strict=True):
        value = values[name]
        axes = getattr(kind, "ndim", 0)
        if axes:
            dtype = np.dtype(str(kind.dtype))
            value = np.empty((0,) * axes, dtype) if value is None else value
            assert value.ndim == axes and value.dtype == dtype and value.flags.c_contiguous, name
        arguments.append(value)
    return partial(kernel, *arguments)

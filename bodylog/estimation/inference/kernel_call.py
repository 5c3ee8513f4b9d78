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
    left = dict(values)
    arguments = [_take_argument(name, kind, left) for name, kind in zip(names, kinds, strict=True)]
    assert not left, left.keys()
    # without a search for the signature that fits: there is one
    return partial(kernel.get_overload(kernel.signatures[0]), *arguments)


def _take_argument(name: str, kind: Any, values: dict[str, Any]) -> Any:
    """An argument of a kernel's type, out of the values: a record takes one for each field."""
    if hasattr(kind, "instance_class"):
        fields = zip(kind.fields, kind, strict=True)
        return kind.instance_class(*[_take_argument(*field, values) for field in fields])
    value = values.pop(name)
    axes = getattr(kind, "ndim", 0)
    if not axes:
        return value
    dtype = np.dtype(str(kind.dtype))
    value = np.empty((0,) * axes, dtype) if value is None else value
    assert value.ndim == axes and value.dtype == dtype and value.flags.c_contiguous, name
    if not kind.mutable:
        value = value.view()
        value.flags.writeable = False
    return value

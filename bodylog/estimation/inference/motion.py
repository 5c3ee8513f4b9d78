"""Motion whose highest derivative is white noise, exactly discretised, for states of any shape."""

from functools import cache
from itertools import product
from math import factorial

import numpy as np

from ...types import Array
from .filter_records import Dynamics


def carry(a: Array | list[Array], dt: Array | float) -> None:
    """Move derivatives of the angle a (O,…) by dt, in place."""
    for state in range(len(a) - 1):
        a[state] += dt * a[state + 1]
        if state + 2 < len(a):
            a[state] += (0.5 * dt * dt) * a[state + 2]


def carry_back(a: Array | list[Array], dt: Array | float) -> None:
    """Move adjoints of the derivatives a (O,…) back by dt, in place: the transpose of `carry`."""
    carry(a[::-1], dt)  # what a derivative adds to the angle, the angle's adjoint adds to the derivative's


@cache
def _terms(order: int) -> list[tuple[int, int, int, int]]:
    """Row, column, power of time and divisor of each covariance that unit white noise in the last rate brings."""
    pairs = [(i, j, 2 * order - 1 - i - j) for i, j in product(range(order), repeat=2)]
    return [(i, j, power, power * factorial(order - 1 - i) * factorial(order - 1 - j)) for i, j, power in pairs]


def grow(p: Array | dict[tuple[int, int], Array], order: int, process: Array | float, dt: Array | float) -> None:
    """Add the process noise of dt to covariances p (O,O,…) of a motion's order, in place."""
    powers = [process * dt]
    for _ in range(2 * order - 2):
        powers.append(powers[-1] * dt)
    for row, column, power, scale in _terms(order):
        p[row, column] += powers[power - 1] / scale


def spreads(dynamics: Dynamics) -> Array:
    """The state's covariance (P,K,K) that process noise brings: the factor of each power dt¹ … dtᴾ of time."""
    m, order, k = len(dynamics.process), dynamics.order, dynamics.size
    found, each = np.zeros((2 * order - 1, k, k)), np.arange(m)
    for row, column, power, scale in _terms(order):
        found[power - 1, row * m + each, column * m + each] = dynamics.process / scale
    if dynamics.drift is not None:
        found[0, range(order * m, k), range(order * m, k)] = dynamics.drift
    return found

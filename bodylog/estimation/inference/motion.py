"""Motion whose highest derivative is white noise, exactly discretised, for states of any shape."""

from functools import cache
from itertools import product
from math import factorial

import numpy as np

from ...types import Array
from .filter_records import Dynamics

EVEN = {2: 16, 3: 4}
"""Instants after which a covariance is made symmetric, before rounding errors grow, by the motion's order."""


def carry(a: Array | list[Array], dt: Array | float) -> None:
    """Move derivatives of the angle a (O,…) by dt, in place."""
    for state in range(len(a) - 1):
        a[state] += dt * a[state + 1]
        if state + 2 < len(a):
            a[state] += (0.5 * dt * dt) * a[state + 2]


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


def moves(dynamics: Dynamics, dt: Array, held: Array) -> tuple[Array, Array, Array]:
    """Move (E,S,S,M), shift (E,S,M), noise (E,S,S,M) within dt (E,) s; of joints held (E,M) as a stationary process."""
    assert dynamics.stationary is not None
    m, order, some = len(dynamics.process), dynamics.order, np.flatnonzero(held.any(axis=1))
    states = dynamics.size // m
    move, noise = np.zeros((2, states, states, m, len(dt)))
    shift = np.zeros(move.shape[1:])
    np.einsum("ss...->s...", move)[:] = 1.0
    carry(move[:order], dt)
    grow(noise, order, dynamics.process[:, None], dt)
    if dynamics.drift is not None:
        noise[order, order] += dynamics.drift[:, None] * dt
    parts = move[:order, :order], shift[:order], noise[:order, :order]
    for whole, step in zip(parts, dynamics.stationary.step(dt[some]), strict=True):
        whole[..., some] = np.where(held[some].T, step, whole[..., some])
    move, shift, noise = (np.moveaxis(part, -1, 0) for part in (move, shift, noise))
    return move, shift, noise


def advance(move: Array, shift: Array, noise: Array, belief: Array) -> None:
    """Move a belief (K,K+1) in place by each joint's move (S,S,M), shift (S,M) and noise (S,S,M)."""
    states, m = shift.shape
    belief[:] = np.einsum("abj,bjk->ajk", move, belief.reshape(states, m, -1)).reshape(belief.shape)
    belief[:, :-1] = np.einsum("abj,kbj->kaj", move, belief[:, :-1].reshape(-1, states, m)).reshape(len(belief), -1)
    belief[:, -1] += shift.ravel()
    np.einsum("ajbj->abj", belief[:, :-1].reshape(states, m, states, m))[:] += noise

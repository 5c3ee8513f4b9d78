"""Motion whose highest derivative is white noise, exactly discretised, for states of any shape."""

from math import factorial

import numpy as np

from ...types import Array
from .filter_records import Dynamics

SPREADS = {
    order: [
        (i, j, 2 * order - 1 - i - j, (2 * order - 1 - i - j) * factorial(order - 1 - i) * factorial(order - 1 - j))
        for i in range(order) for j in range(order)
    ]
    for order in (2, 3)
}  # fmt: skip
"""Rows, columns, powers of time and divisors of the covariance that unit white noise in the last rate brings."""


def carry(a: Array | list[Array], dt: Array | float) -> None:
    """Move derivatives of the angle a (O,…) by dt, in place."""
    for state in range(len(a) - 1):
        a[state] += dt * a[state + 1]
        if state + 2 < len(a):
            a[state] += (0.5 * dt * dt) * a[state + 2]


def carry_back(a: Array | list[Array], dt: Array | float) -> None:
    """Move adjoints of the derivatives a (O,…) back by dt, in place: the transpose of `carry`."""
    for state in range(len(a) - 1, 0, -1):
        a[state] += dt * a[state - 1]
        if state > 1:
            a[state] += (0.5 * dt * dt) * a[state - 2]


def grow(p: Array | dict[tuple[int, int], Array], order: int, process: Array | float, dt: Array | float) -> None:
    """Add the process noise of dt to covariances p (O,O,…) of a motion's order, in place."""
    powers = [process * dt]
    for _ in range(2 * order - 2):
        powers.append(powers[-1] * dt)
    for row, column, power, scale in SPREADS[order]:
        p[row, column] += powers[power - 1] / scale


def spreads(dynamics: Dynamics) -> Array:
    """The state's covariance (P,K,K) that process noise brings: the factor of each power dt¹ … dtᴾ of time."""
    m, order, k = len(dynamics.process), dynamics.order, dynamics.size
    found, each = np.zeros((2 * order - 1, k, k)), np.arange(m)
    for row, column, power, scale in SPREADS[order]:
        found[power - 1, row * m + each, column * m + each] = dynamics.process / scale
    if dynamics.drift is not None:
        found[0, range(order * m, k), range(order * m, k)] = dynamics.drift
    return found


class Motion:
    """Motion with white acceleration or jerk, exactly discretised, in plain matrices."""

    def __init__(self, dynamics: Dynamics) -> None:
        """Motion for dynamics with process (M,)."""
        k, m, order = dynamics.size, len(dynamics.process), dynamics.order
        self.joints, self.order, self.offset, self.is_prior = m, order, dynamics.offset, dynamics.is_prior
        self._shifts, self._spread = [np.eye(k)], spreads(dynamics)
        for lag in range(1, order):
            self._shifts.append(np.eye(k, k, lag * m) / factorial(lag))
            self._shifts[-1][(order - lag) * m :] = 0.0
        self._stationary = dynamics.stationary

    def move(
        self, z: Array, p: Array, dt: float, more: Array | None = None, held: Array | None = None
    ) -> tuple[Array, Array]:
        """z (K,) and p (K,K) after dt (s), with `more` (M,) times the process variance.

        held (M,) bool: joints that keep to their stationary motion.
        """
        f, spread, power = self._shifts[0], np.zeros_like(p), 1.0
        for shift in self._shifts[1:]:
            power *= dt
            f = f + power * shift
        for one in self._spread[::-1]:
            spread = dt * (one + spread)
        if more is not None:
            spread[: self.order * self.joints] *= np.tile(more, self.order)[:, None]
        kept = np.zeros(len(z))
        if held is not None and held.any() and self._stationary is not None:
            f, own = f.copy(), np.arange(self.order * self.joints).reshape(self.order, self.joints)[:, held]
            move, shift, noise = (part[..., held, 0] for part in self._stationary.step(np.array([dt])))
            f[own[:, None], own], kept[own], spread[own[:, None], own] = move, shift, noise
        p = f @ p @ f.T + spread
        return f @ z + kept, 0.5 * (p + p.T)

"""Motion whose highest derivative is white noise, exactly discretised, for states of any shape."""

from math import factorial

from ...types import Array

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


def grow(p: Array, process: Array | float, dt: Array | float) -> None:
    """Add the process noise of dt to covariances p (O,O,…), in place."""
    powers = [process * dt]
    for _ in range(2 * len(p) - 2):
        powers.append(powers[-1] * dt)
    for row, column, power, scale in SPREADS[len(p)]:
        p[row, column] += powers[power - 1] / scale

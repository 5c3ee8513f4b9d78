"""The gate of the filter: readings too far from the belief to be Gaussian."""

import numpy as np

from ...types import Array

GATE = 5.0
"""Standard deviations: a larger innovation d has its noise inflated so that its weight falls as (GATE/d)⁴."""
FLAT = 1.0
"""Nats from the gate's ½ GATE² to an outlier's cost anywhere: one in a hundred in an image of 320×240 px costs 14."""


def mahalanobis(nu: Array, total: Array, s: Array) -> tuple[Array, Array]:
    """Square of innovations nu (D,C) over variances total (D,C) and covariances s (D,D,C); the determinant (C,)."""
    off, var, cross = list(nu), list(total), [list(row) for row in s]
    square, size = off[0] * off[0] / var[0], var[0]
    for e in range(1, len(off)):
        for d in range(e):
            share = cross[d][e] / var[d]
            off[e], var[e] = off[e] - share * off[d], var[e] - share * cross[d][e]
            for f in range(e + 1, len(off)):
                cross[e][f] = cross[e][f] - share * cross[d][f]
        square, size = square + off[e] * off[e] / var[e], size * var[e]
    return square, size


def raised(var: Array, total: Array, d2: Array, gate: float = GATE) -> Array:
    """Noise `var` for innovations of variance `total`, inflated by (d/gate)⁴ − 1 totals outside the gate."""
    over = d2 > gate * gate
    return var + total * np.where(over, (d2 / (gate * gate)) ** 2 - 1.0, 0.0) if over.any() else var


def outlier_cost(d2: Array, inflated: Array | None = None, logs: Array | None = None, gate: float = GATE) -> Array:
    """Nats that innovations of squares d2 cost beyond a Gaussian of the inflated noise; 0 inside the gate.

    The whole cost is that of a density that hardly falls any more outside the gate: it grows with distance. inflated:
    their squares with the inflated noise · logs: logarithm of the ratio of the variances' determinants. Both follow
    from d2 for single readings.
    """
    over = d2 / (gate * gate)
    if not (over > 1.0).any():
        return np.zeros(over.shape)
    over = np.fmax(over, 1.0)
    own = GATE * GATE / over if inflated is None else inflated
    cost = 0.5 * GATE * GATE + FLAT * (1.0 - 1.0 / over) - 0.5 * own - (np.log(over) if logs is None else 0.5 * logs)
    return np.where(over > 1.0, cost, 0.0)

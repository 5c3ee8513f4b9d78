"""One instant at a time: the same filter kernel, linearised anew until the belief of this instant rests."""

from collections.abc import Sequence

import numpy as np

from ..types import Array
from .alike import Sight
from .scan import Dynamics, Readings, Trace, scan

ITERATIONS = 30
HASTY = 8
"""Full Gauss–Newton steps before half ones: where the tangents overshoot, these close in."""
RESTING = 1e-10
"""rad: how little the point of linearisation may still move."""


def hear(
    dynamics: Dynamics, z: Array, p: Array, dt: float, encoders: Array, encoder_var: Array, sights: Sequence[Sight],
    remember: bool = False, resting: float = RESTING,
) -> tuple[Readings, Trace]:  # fmt: skip
    """Move z (K,), p (K,K) by dt and hear encoders (M,), NaN where silent, and sights; what came of it.

    `resting` (rad) is how little the point of linearisation may still move.
    """
    m = len(encoders)
    x = z[:m] + dt * z[m : 2 * m]
    for iteration in range(ITERATIONS):
        readings = _readings(dt, encoders, encoder_var, sights, x)
        trace = scan(readings, dynamics, z[:, None], p[:, :, None], remember)
        move = trace.z[0, :m, 0] - x
        x = x + (move if iteration < HASTY else 0.5 * move)
        if not any(sight.seen for sight in sights) or np.abs(move).max() < resting:
            break
    return readings, trace


def _readings(dt: float, encoders: Array, encoder_var: Array, sights: Sequence[Sight], x: Array) -> Readings:
    m, tracks = len(encoders), len(sights)
    y, jac, var = np.full((tracks, 2), np.nan), np.zeros((tracks, 2, m)), np.ones((tracks, 2))
    for index, sight in enumerate(sights):
        if sight.seen:
            mean, jac[index], var[index], _ = sight.at(x)
            y[index] = sight.value - mean + jac[index] @ x
    parts = (np.array(dt), encoders, encoder_var, y, jac, var)
    return Readings(*(part[None, ..., None] for part in parts))

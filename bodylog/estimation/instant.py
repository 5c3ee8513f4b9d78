"""One instant at a time: the same filter kernel, linearised anew until the belief of this instant rests."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..types import Array, ForwardModel
from .scan import Dynamics, Readings, Trace, scan

ITERATIONS = 30
HASTY = 8
"""Full Gauss–Newton steps before half ones: where the tangents overshoot, these close in."""
RESTING = 1e-10
"""rad: how little the point of linearisation may still move."""
ALIKE = 0.01
"""rad: angles closer than this share the model's error."""


@dataclass(frozen=True, eq=False)
class Sight:
    """One track at this instant: its model, value (D,), NaN when unseen, pixel variance (D,), and its memory."""

    model: ForwardModel
    value: Array
    var: Array
    memory: "Memory"

    def seen_at(self, x: Array) -> "Memory":
        """The track's memory after this instant, if the belief is x."""
        return Memory(x, self.memory.again(x)) if np.isfinite(self.value).all() else self.memory


@dataclass(frozen=True, eq=False)
class Memory:
    """Where (M,) rad a track was last seen, and how many times from nearly there."""

    x: Array | None = None
    count: float = 0.0

    def again(self, x: Array) -> float:
        """The count if it is now seen at x."""
        if self.x is None:
            return 1.0
        return float(1.0 + np.exp(-np.linalg.norm(x - self.x) / ALIKE) * self.count)


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
        if not any(np.isfinite(s.value).all() for s in sights) or np.abs(move).max() < resting:
            break
    return readings, trace


def _readings(dt: float, encoders: Array, encoder_var: Array, sights: Sequence[Sight], x: Array) -> Readings:
    m, tracks = len(encoders), len(sights)
    y, jac, var = np.full((tracks, 2), np.nan), np.zeros((tracks, 2, m)), np.ones((tracks, 2))
    for index, sight in enumerate(sights):
        if not np.isfinite(sight.value).all():
            continue
        mean, slope, own = sight.model.predict(x[None])
        y[index], jac[index] = sight.value - mean[0] + slope[0] @ x, slope[0]
        var[index] = sight.var + own[0] * (2.0 * sight.memory.again(x) - 1.0)
    parts = (np.array(dt), encoders, encoder_var, y, jac, var)
    return Readings(*(part[None, ..., None] for part in parts))

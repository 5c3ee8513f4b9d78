"""Motion and encoder readings of one belief, with as few calls of numpy as possible.

A belief is one array (K,K+1): the rows of the covariance, each followed by the mean, so that both are updated at once.
"""

import math
from collections.abc import Sequence

import numpy as np

from ...types import Array
from .filter_records import Dynamics
from .gate import GATE, outlier_cost, raised
from .motion import advance, carry, moves, spreads


class EncoderSteps:
    """Motion and encoder offsets of given dynamics."""

    def __init__(self, dynamics: Dynamics) -> None:
        """Dynamics with process (M,)."""
        self.joints, self._dynamics, self._offsets = len(dynamics.process), dynamics, dynamics.offset or 0
        self._counts = [dynamics.is_prior is None or not dynamics.is_prior[j] for j in range(self.joints)]
        spread = np.pad(spreads(dynamics), ((0, 0), (0, 0), (0, 1)))
        self._flat = spread.reshape(len(spread), -1)

    def moved(self, belief: Array, dt: float, more: Array | None = None, held: Array | None = None) -> Array:
        """The belief (K,K+1) after dt (s), with `more` (M,) times the process variance.

        held (M,) bool: joints that keep to their stationary motion, if there is one.
        """
        m, order, found = self.joints, self._dynamics.order, belief.copy()
        if held is not None and self._dynamics.stationary is not None:
            move, shift, noise = (part[0] for part in moves(self._dynamics, np.array([dt]), held[None]))
            advance(move, shift, noise, found)
            return found
        for part in (found, found.T):
            carry(part[: order * m].reshape(order, m, -1), dt)  # a view
        powers = [dt**power for power in range(1, 2 * order)]
        spread = np.array(powers).dot(self._flat).reshape(found.shape)
        if more is not None:
            spread[: order * m] *= np.tile(more, order)[:, None]
        found += spread
        return found

    def gated(
        self, belief: Array, readings: Sequence[float], var: Sequence[float]
    ) -> tuple[Sequence[float], list[float], float]:
        """Encoder variances (M) after gating by the belief, innovations (M) in standard deviations, `outlier_cost`.

        readings (M) rad, NaN where silent. The posture prior's readings are not gated and have no innovations.
        """
        total, d, first, far = list(var), [math.nan] * self.joints, self._offsets, False
        rows = belief[: self.joints] + belief[first:] if first else belief[: self.joints]
        for j, (reading, row) in enumerate(zip(readings, rows.tolist(), strict=True)):
            if reading == reading and self._counts[j]:
                # rounding takes a variance below 0 after a reading far surer than the belief
                total[j] += max(row[j] + (row[first + j] if first else 0.0), 0.0)
                d[j] = (reading - row[-1]) / math.sqrt(total[j])
                far = far or abs(d[j]) > GATE
        if not far:
            return var, d, 0.0
        d2 = np.square(d)
        return raised(np.array(var), np.array(total), d2).tolist(), d, float(outlier_cost(d2).sum())

    def condition(self, belief: Array, readings: Sequence[float], var: Sequence[float]) -> float:
        """Condition a belief (K,K+1), in place, on readings (M) rad, NaN where silent; their nats.

        LinAlgError where a variance is not above 0.
        """
        nats, first = 0.0, self._offsets
        for j, reading in enumerate(readings):
            if reading == reading:
                # covariance of state and reading, and the prediction less the reading
                row = belief[first + j] + belief[j] if first else belief[j].copy()
                row[-1] -= reading
                s, off = row.item(j) + var[j] + (row.item(first + j) if first else 0.0), row.item(-1)
                if not s > 0.0:
                    raise np.linalg.LinAlgError(f"encoder {j + 1} has the predicted variance {s:.3g} rad²")
                weight = 1.0 / s
                belief -= (weight * row[:-1, None]) * row
                if self._counts[j]:
                    nats += 0.5 * (off * off * weight + math.log(2.0 * math.pi * s))
        return nats

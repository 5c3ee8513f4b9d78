"""One instant of encoder readings, one belief at a time, with as few calls of numpy as possible.

The same equations as `motion.Motion.move` and `instant.hear` without tracks. A belief is one array (K,K+1): the rows
of the covariance, each followed by the mean, so that both are updated at once.
"""

import math
from collections.abc import Sequence

import numpy as np

from ...types import Array
from .conditioning import FLAT
from .filter_records import GATE, Dynamics
from .motion import carry, spreads

_LOG = math.log(2.0 * math.pi)


class EncoderSteps:
    """Motion and encoder offsets of given dynamics, and encoders of given variances."""

    def __init__(self, dynamics: Dynamics, encoder: Array) -> None:
        """Dynamics with process (M,), and encoder variances (M,) rad²."""
        self.joints, self._order = len(dynamics.process), dynamics.order
        self._var, self._offsets = encoder.tolist(), dynamics.offset or 0
        spread = np.pad(spreads(dynamics), ((0, 0), (0, 0), (0, 1)))
        self._flat = spread.reshape(len(spread), -1)

    def moved(self, belief: Array, dt: float) -> Array:
        """The belief (K,K+1) after dt (s)."""
        m, order, found = self.joints, self._order, belief.copy()
        for part in (found, found.T):
            carry(part[: order * m].reshape(order, m, -1), dt)  # a view
        powers = [dt**power for power in range(1, 2 * order)]
        found += np.array(powers).dot(self._flat).reshape(found.shape)
        return found

    def condition(self, belief: Array, readings: Sequence[float]) -> tuple[float, list[float]]:
        """Condition a belief (K,K+1), in place, on readings (M) rad, NaN where silent; nats, innovations (M).

        Innovations are in standard deviations. The prior's gate makes the result independent of the order.
        ArithmeticError where a variance is not above 0.
        """
        noise, d = self._gated(belief, readings)
        nats, first = 2.0 * self._outliers(d), self._offsets
        for j, reading in enumerate(readings):
            if reading == reading:
                # covariance of state and reading, and the prediction less the reading
                row = belief[first + j] + belief[j] if first else belief[j].copy()
                row[-1] -= reading
                s, off = row.item(j) + noise[j] + (row.item(first + j) if first else 0.0), row.item(-1)
                if not s > 0.0:
                    raise ArithmeticError(f"encoder {j + 1} has the predicted variance {s:.3g} rad²")
                weight = 1.0 / s
                belief -= (weight * row[:-1, None]) * row
                nats += off * off * weight + math.log(s) + _LOG
        return 0.5 * nats, d

    def _gated(self, belief: Array, readings: Sequence[float]) -> tuple[list[float], list[float]]:
        """Variances (M) of the encoders after gating by the belief, and the innovations in standard deviations (M)."""
        noise, d, first = list(self._var), [math.nan] * self.joints, self._offsets
        rows = belief[: self.joints] + belief[first:] if first else belief[: self.joints]
        for j, (reading, row) in enumerate(zip(readings, rows.tolist(), strict=True)):
            if reading == reading:
                s = row[j] + noise[j] + (row[first + j] if first else 0.0)
                d[j] = (reading - row[-1]) / math.sqrt(s) if s > 0.0 else math.inf
                if (over := d[j] * d[j] / (GATE * GATE)) > 1.0:
                    noise[j] += s * (over * over - 1.0)
        return noise, d

    def _outliers(self, d: list[float]) -> float:
        """`outlier_cost` of innovations d (M)."""
        overs = (x * x / (GATE * GATE) for x in d)
        return sum((0.5 * GATE * GATE + FLAT) * (1.0 - 1.0 / over) - math.log(over) for over in overs if over > 1.0)


def even(belief: Array) -> None:
    """Make the covariance of a belief (K,K+1) symmetric, in place, before rounding errors grow."""
    cov = belief[:, :-1]
    cov[:] = 0.5 * (cov + cov.T)

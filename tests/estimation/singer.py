"""Singer's motion model, as someone adds it: one class, and one line in the table of motion models."""

from dataclasses import dataclass

import numpy as np

from bodylog.types import Array

PLACES, WEIGHTS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True)
class Singer:
    """Acceleration as an Ornstein–Uhlenbeck process that lasts `seconds`; process noise in rad²/s⁵ (Singer 1970)."""

    seconds: float
    order: int = 3

    def transition(self, gap: Array) -> Array:
        share = gap / self.seconds
        kept = np.exp(-share)
        rate = -self.seconds * np.expm1(-share)
        move = np.tile(np.eye(3), (len(gap), 1, 1))
        move[:, 0, 1] = gap
        move[:, 0, 2] = self.seconds * (gap - rate)
        move[:, 1, 2] = rate
        move[:, 2, 2] = kept
        return move

    def covariance(self, gap: Array) -> Array:
        """The integral of what noise at each time has become, by Gauss and Legendre."""
        found = np.zeros((len(gap), 3, 3))
        for place, weight in zip(0.5 + 0.5 * PLACES, 0.5 * WEIGHTS, strict=True):
            column = self.transition(place * gap)[:, :, 2]
            found += (weight * gap)[:, None, None] * column[:, :, None] * column[:, None, :]
        return found

"""Encoders that do not read the angle itself: a function of it for each joint, s_p = g_p(x) (paper, E2: x²)."""

from dataclasses import dataclass

import numpy as np

from ..types import Array


@dataclass(frozen=True, eq=False)
class Polynomial:
    """What M encoders read: reading m = Σₖ coefficients[m,k] xₘᵏ, coefficients (M,K) of ascending powers.

    As body.senses["encoders"] it takes the place of s_p = x. An exploration alone cannot tell it: angles in any
    other unit explain all that was seen as well, so it is given.
    """

    outputs: tuple[str, ...]
    coefficients: Array
    unit: str = "rad"

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """At x (N,M) rad: reading (N,M) · Jacobian (N,M,M) · no model variance (N,M)."""
        x = np.atleast_2d(x)
        powers = x[:, :, None] ** np.arange(self.coefficients.shape[1])
        rising = self.coefficients[:, 1:] * np.arange(1, self.coefficients.shape[1])
        slope = (powers[:, :, :-1] * rising).sum(axis=2)
        return (powers * self.coefficients).sum(axis=2), slope[:, :, None] * np.eye(x.shape[1]), np.zeros(x.shape)

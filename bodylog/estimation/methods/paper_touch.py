"""Touch as printed in the paper: g_t = f_s f_t itself enters the prediction errors, not its logarithm."""

from dataclasses import dataclass

import numpy as np

from ...body_model import BodyModel, ForwardModel, TouchConstants
from ...types import Array, Features
from ..measurements.touch import strongest


@dataclass(frozen=True, eq=False)
class Literal:
    """On a grid: active (N,) · hand (N,2) px · f_t (N,) temporal coherence; with the model and constants it needs."""

    model: ForwardModel
    constants: TouchConstants
    active: Array
    hand: Array
    temporal: Array

    def pull(self, k: int, x: Array) -> tuple[float, Array]:
        """Error e_t = (s_t − g_t)/σ_t, s_t being g_t's best value and σ_t, not printed, 1; ∂g_t/∂x (M,) at step k."""
        mean, jac, _ = self.model.predict(x[None])
        apart = mean[0] - self.hand[k]
        best = self.constants.a1 * self.temporal[k]
        g = best * np.exp(-self.constants.b1 * float(apart @ apart))
        # ∂g_t/∂x = −2 b₁ g_t (g_v − o_v)ᵀ J
        return float(best - g), -2.0 * self.constants.b1 * g * (apart @ jac[0])


def literal(features: Features, body: BodyModel, t: Array, dt: float) -> Literal:
    """Touch, of which there is a sighting, on the grid t (N,) s."""
    hand = features.hand
    assert hand is not None
    rows = np.maximum(np.searchsorted(hand.t, t + 1e-9, "right") - 1, 0)
    seen = np.isfinite(hand.values[rows]).all(axis=1) & (np.abs(t - hand.t[rows]) < max(dt, 0.2))
    temporal, _ = strongest(features, t)
    return Literal(body.senses["effector"], body.touch, seen & (temporal > 0), hand.values[rows], temporal)

"""Touch as printed in the paper: g_t = f_s f_t itself
enters the prediction errors, not its logarithm.
"""

from dataclasses import dataclass

import numpy as np

from ...body_model import BodyModel, ForwardModel, TouchConstants
from ...types import Array, Features
from ..measurements.touch import find_strongest_touches


@dataclass(frozen=True, eq=False)
class PaperTouch:
    """On a grid: active (N,) · hand (N,2) px · f_t (N,)
    temporal coherence; with the model and constants it needs.
    """

    model: ForwardModel
    constants: TouchConstants
    active: Array
    hand: Array
    temporal: Array

    def pull(self, k: int, x: Array) -> tuple[float, Array]:
        """s_t − g_t, s_t being g_t's best value, NaN where
        nothing is felt; and ∂g_t/∂x (M,) at step k and x (M,).
        """
        if not self.active[k]:
            return float("nan"), np.zeros(len(x))
        mean, jac, _ = self.model.predict(x[None])
        best = np.array([self.constants.a1 * self.temporal[k]])
        g, slope = spatial_coherence(mean - self.hand[k], jac, best, np.array([self.constants.b1]))
        return float(best[0] - g[0]), slope[0]


def spatial_coherence(apart: Array, jac: Array, best: Array, b1: Array) -> tuple[Array, Array]:
    """g_t = best exp(−b₁ |g_v − o_v|²) (B,), best being
    a₁ f_t, and ∂g_t/∂x = −2 b₁ g_t (g_v − o_v)ᵀ J (B,M).

    apart (B,2): g_v − o_v · jac (B,2,M): J.
    """
    g = best * np.exp(-b1 * (apart**2).sum(axis=1))
    return g, -2.0 * (b1 * g)[:, None] * np.einsum("bd,bdm->bm", apart, jac)


def build_paper_touch(features: Features, body: BodyModel, t: Array, dt: float) -> PaperTouch:
    """Touch, of which there is a sighting, on the grid t (N,) s."""
    hand = features.hand
    assert hand is not None
    rows = np.maximum(np.searchsorted(hand.t, t + 1e-9, "right") - 1, 0)
    seen = np.isfinite(hand.values[rows]).all(axis=1) & (np.abs(t - hand.t[rows]) < max(dt, 0.2))
    temporal, _ = find_strongest_touches(features, t)
    return PaperTouch(
        body.senses["effector"], body.touch, seen & (temporal > 0), hand.values[rows], temporal
    )

"""Touch as a sighting (METHOD 3): while the skin is stroked in time with what is seen, the hand is at the effector."""

import numpy as np

from ..types import Array, Features, TouchConstants


def sightings(features: Features, constants: TouchConstants) -> tuple[Array, Array, Array, Array]:
    """Where touch says the effector is: t (K,) s · values (K,2) px · variance (K,2) px² · source_ns (K,)."""
    hand = features.hand
    if hand is None or not features.touches:
        return np.empty(0), np.empty((0, 2)), np.empty((0, 2)), np.empty(0, np.int64)
    weight = weights(features, hand.t)
    keep = (weight > 0) & np.isfinite(hand.values).all(axis=1)
    # ln g_t = -b1 w |g_v - o_v|^2 + const: a Gaussian of variance 1 / (2 b1 w)
    var = 1.0 / (2.0 * constants.b1 * weight[keep])
    return hand.t[keep], hand.values[keep], np.stack([var, var], axis=1), hand.source_ns[keep]


def weights(features: Features, t: Array) -> Array:
    """Synchrony weight (K,) of the touch under way at each time, 0 where there is none."""
    weight = np.zeros(len(t))
    for pair in features.synchrony:
        touch = (features.touches or ())[pair.touch]
        during = (t >= touch.onset) & (t <= touch.offset)
        weight[during] = np.maximum(weight[during], pair.weight)
    return weight

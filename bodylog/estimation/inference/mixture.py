"""Outlier mixture: a measurement is an inlier with probability 1 − ε, else uniform with density 1/V.

−ln[(1 − ε) N(ν; 0, S) + ε/V] grows with |ν| everywhere, so that pushing an outlier further out saves no cost.
"""

import numpy as np

from ...types import Array

RATE = 1e-3
"""ε: prior probability of an outlier."""


def inlier(nu: Array, var: Array, density: float) -> tuple[Array, Array]:
    """Probability of being an inlier, and cost in nats, which equals the Gaussian's for sure inliers.

    nu, var: innovations and their variances · density: 1/V of outliers, in the measurement's own unit.
    """
    gaussian = 0.5 * (nu * nu / var + np.log(var) + np.log(2.0 * np.pi))
    worse = np.log1p(-RATE) - gaussian - np.log(RATE * density)
    # the constant −ln(1 − ε) is left out, so that a sound log costs what a Kalman filter's does
    cost = np.where(worse > 0.0, gaussian - np.log1p(np.exp(-np.abs(worse))), 0.0)
    far = np.log1p(-RATE) - np.log(RATE * density) - np.log1p(np.exp(-np.abs(worse)))
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(worse, -700.0, 700.0)))), np.where(worse > 0.0, cost, far)


def raised(var: Array, total: Array, weight: Array) -> Array:
    """Noise `var` of an innovation of variance `total`, inflated such that its weight falls by `weight`."""
    return np.asarray(var + total * (1.0 / np.maximum(weight, 1e-12) - 1.0))

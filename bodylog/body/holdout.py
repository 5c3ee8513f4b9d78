"""Held-out residuals without refitting: leave one block of time out of an exact GP, in closed form (R&W 5.12)."""

import numpy as np

from ..types import Array
from .gp import GP


def residuals(gp: GP, block: Array) -> tuple[Array, Array]:
    """Residual (n,D) of each sample predicted without its block, and its predicted variance (n,D), noise included."""
    residual, variance = np.empty(gp.targets.shape), np.empty(gp.targets.shape)
    factors = np.broadcast_to(gp.factor, (len(gp.weights), *gp.factor.shape[1:]))
    for d, (factor, weights) in enumerate(zip(factors, gp.weights, strict=True)):
        for label in np.unique(block):
            rows = block == label
            inner = np.linalg.inv(factor[:, rows].T @ factor[:, rows])
            residual[rows, d] = inner @ weights[rows]
            variance[rows, d] = np.diag(inner)
    return residual, variance

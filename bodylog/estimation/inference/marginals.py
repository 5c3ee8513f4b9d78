"""Smoothed covariances of the knots: blocks of the inverse of a block tridiagonal matrix."""

import numpy as np

from ...linear_algebra import selected_inverse
from ...types import Array
from .banded import System


def marginals(given: System) -> tuple[Array, Array]:
    """Smoothed covariances (B,K,K) of the knots, and (B−1,K,K) of each with the next."""
    k, knots = given.pull.shape
    s, m = given.shape
    upper = np.zeros((knots - 1, k, k))
    for j in range(m):
        own = slice(j * s, j * s + s)
        upper[:, own, own] = np.moveaxis(given.ahead.across[:, :, j], -1, 0)
    return selected_inverse(np.ascontiguousarray(np.moveaxis(given.own, -1, 0)), upper)

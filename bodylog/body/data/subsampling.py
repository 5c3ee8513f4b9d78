"""Subsampling: farthest points to thin an exploration,
greatest variance to choose inducing points.
"""

import numpy as np

from ...types import Array


def choose_spaced_rows(total: int, count: int) -> Array:
    """At most `count` of `total` rows, evenly spaced, with the first and last."""
    return np.unique(np.linspace(0, total - 1, min(total, count)).round().astype(int))


def choose_farthest_rows(x: Array, count: int) -> Array:
    """Rows of x (N,M) rad, ascending, that cover it best:
    each the farthest from those before (Gonzalez 1985).
    """
    if len(x) <= count:
        return np.arange(len(x))
    chosen = np.empty(count, np.int64)
    distance = np.square(x - x.mean(axis=0)).sum(axis=1)
    for k in range(count):
        chosen[k] = np.argmax(distance)
        apart = np.square(x - x[chosen[k]]).sum(axis=1)
        distance = apart if k == 0 else np.minimum(distance, apart)
    return np.unique(chosen)


def choose_pivot_rows(z: Array, most: int, tolerance: float) -> Array:
    """Rows of z (N,M), in length scales, each of greatest
    variance given those before; ends below `tolerance`.

    A Cholesky factorisation with pivots (Foster et al.
    2009), so the kernel of the rows is well conditioned.
    """
    left = np.ones(len(z))
    factor = np.empty((min(most, len(z)), len(z)))
    chosen: list[int] = []
    while len(chosen) < len(factor):
        pivot = int(np.argmax(left))
        if left[pivot] < tolerance and chosen:
            break
        known = factor[: len(chosen)]
        column = np.exp(-0.5 * np.square(z - z[pivot]).sum(axis=1)) - known[:, pivot] @ known
        factor[len(chosen)] = column / np.sqrt(left[pivot])
        left = np.maximum(left - factor[len(chosen)] ** 2, 0.0)
        left[pivot] = 0.0
        chosen.append(pivot)
    return np.array(chosen)

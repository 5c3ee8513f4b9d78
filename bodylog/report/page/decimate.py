"""Decimation that keeps a plot's look: each bin keeps its lowest and highest value and its gaps."""

import numpy as np

from ...types import Array


def thin_curve(t: Array, values: Array, points: int) -> tuple[Array, Array]:
    """t, values (n,) with at most about `points` kept: the
    extremes of each bin, and one NaN where a bin has a gap.
    """
    keep = extreme_indices(values, points)
    return t[keep], values[keep]


def extreme_indices(values: Array, points: int) -> Array:
    """Indices, ascending, of the lowest, highest and
    first missing value of each of points / 3 bins.
    """
    n = len(values)
    bins = max(1, points // 3)
    if n <= points:
        return np.arange(n)
    blocks, index = _split_into_bins(values, bins)
    missing = ~np.isfinite(blocks) & (index < n)
    low = np.where(np.isfinite(blocks), blocks, np.inf).argmin(axis=1)
    high = np.where(np.isfinite(blocks), blocks, -np.inf).argmax(axis=1)
    rows = np.arange(len(blocks))
    gaps = missing.argmax(axis=1)[missing.any(axis=1)], rows[missing.any(axis=1)]
    kept = np.concatenate(
        [index[rows, low], index[rows, high], index[gaps[1], gaps[0]], [0, n - 1]]
    )
    return np.unique(kept[kept < n])


def thin_band(t: Array, low: Array, high: Array, points: int) -> tuple[Array, Array, Array]:
    """t, low, high (n,) in at most `points` bins: a band never narrower than the full one."""
    if len(t) <= points:
        return t, low, high
    starts = np.unique(np.linspace(0, len(t), points, endpoint=False).astype(np.int64))
    middle = (starts + np.append(starts[1:], len(t)) - 1) // 2
    return t[middle], np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)


def _split_into_bins(values: Array, bins: int) -> tuple[Array, Array]:
    size = -(-len(values) // bins)
    rows = -(-len(values) // size)
    index = np.arange(rows * size).reshape(rows, size)
    padded = np.full(rows * size, np.nan)
    padded[: len(values)] = values
    return padded.reshape(rows, size), index

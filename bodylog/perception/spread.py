"""How far a track's points scatter, steadied over time: one picture's outline alone says it only roughly."""

import numpy as np

from ..types import Array

_NEAR = 0.5
_FAR_MORE = 3.0
_MEDIAN = 0.8391**0.5
"""Median over mean of a variance that two complex waves tell (chi-squared with four degrees), as deviations."""


def steady(t: Array, std: Array) -> Array:
    """std (N,2) px as it usually is within half a second, or its own where that is far more; NaN rows stay NaN."""
    seen = np.isfinite(std[:, 0])
    times, own = t[seen], std[seen]
    low, high = np.searchsorted(times, times - _NEAR), np.searchsorted(times, times + _NEAR, side="right")
    usual = np.array([np.median(own[i:j], axis=0) for i, j in zip(low.tolist(), high.tolist(), strict=True)])
    usual = usual.reshape(own.shape) / _MEDIAN
    steadied = np.full(std.shape, np.nan)
    steadied[seen] = np.where(own > _FAR_MORE * usual, own, usual)
    return steadied

"""How far a track's points scatter, steadied over time: one picture's outline alone says it only roughly."""

import numpy as np

from ..types import Array

_NEAR = 0.5
_FAR_MORE = 3.0
_AT_ONCE = 1024
_MEDIAN = 0.8391**0.5
"""Median over mean of a variance that two complex waves tell (chi-squared with four degrees), as deviations."""


def steady(t: Array, std: Array) -> Array:
    """std (N,2) px as it usually is within half a second, or its own where that is far more; NaN rows stay NaN."""
    seen = np.isfinite(std[:, 0])
    times, own = t[seen], std[seen]
    low, high = np.searchsorted(times, times - _NEAR), np.searchsorted(times, times + _NEAR, side="right")
    usual = _medians(own, low, high) / _MEDIAN
    steadied = np.full(std.shape, np.nan)
    steadied[seen] = np.where(own > _FAR_MORE * usual, own, usual)
    return steadied


def _medians(values: Array, low: Array, high: Array) -> Array:
    """Medians of values[low:high], column by column: (N,2) of values (N,2), by sorted windows of a thousand rows."""
    count = high - low
    medians = np.empty_like(values)
    for start in range(0, len(values), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        places = low[some, None] + np.arange(count[some].max())
        inside = places < high[some, None]
        windows = np.where(inside[:, :, None], values[np.where(inside, places, 0)], np.inf)
        windows.sort(axis=1)
        middle = np.stack([(count[some] - 1) // 2, count[some] // 2], axis=1)
        medians[some] = np.take_along_axis(windows, middle[:, :, None], axis=1).mean(axis=1)
    return medians

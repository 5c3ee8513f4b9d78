"""Smooth a track's standard deviations over time: one image's outline gives only a rough one."""

import numpy as np

from ...types import Array

_NEAR = 0.5
_FAR_MORE = 3.0
_AT_ONCE = 1024


def smooth_std(t: Array, std: Array) -> Array:
    """The usual std (N,2) px within half a second, or a
    point's own where that is far larger; NaN rows stay NaN.

    The usual variance is the mean without values far above the median: outlines that differ from
    image to image average out, and those of a still target keep their one value.
    """
    seen = np.isfinite(std[:, 0])
    times = t[seen]
    own = std[seen]
    low = np.searchsorted(times, times - _NEAR)
    high = np.searchsorted(times, times + _NEAR, side="right")
    usual = np.sqrt(_windowed_means(own**2, low, high))
    steadied = np.full(std.shape, np.nan)
    steadied[seen] = np.where(own > _FAR_MORE * usual, own, usual)
    return steadied


def _windowed_means(values: Array, low: Array, high: Array) -> Array:
    """Means of values[low:high] up to _FAR_MORE² medians,
    by column: (N,2) of (N,2), a thousand rows at once.
    """
    count = high - low
    means = np.empty(values.shape[::-1])
    for start in range(0, len(values), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        places = low[some, None] + np.arange(count[some].max())
        inside = places < high[some, None]
        windows = np.where(inside, values.T[:, np.where(inside, places, 0)], np.inf)
        windows.sort(axis=2)
        middle = np.stack([(count[some] - 1) // 2, count[some] // 2], axis=1)
        most = _FAR_MORE**2 * np.take_along_axis(windows, middle[None], axis=2).mean(axis=2)
        usual = windows <= most[:, :, None]
        means[:, some] = np.where(usual, windows, 0).sum(axis=2) / usual.sum(axis=2)
    return means.T

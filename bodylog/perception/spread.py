"""How far a track scatters: what its own path says of the errors that its pictures state."""

import numpy as np

from ..types import Array

_NEAR = 0.5
_ORDERS = (4, 5, 6)
_STEP = 1.0
_ENOUGH = 30
_OUTLIER = 3.0
_MOST = 3.0


def calibrated(t: Array, place: Array, std: Array) -> Array:
    """std (N,2) px smoothed over time and scaled, per axis, to how `place` (N,2) px scatters about a smooth path.

    Rows not seen are NaN in both. Where the target moves too little to tell, the scale stays 1: errors that come
    from the pixels' grid repeat themselves there.
    """
    seen = np.flatnonzero(np.isfinite(place[:, 0]))
    stated = np.full(std.shape, np.nan)
    stated[seen] = np.sqrt(_running_mean(t[seen], std[seen] ** 2))
    return np.asarray(stated * [_scale(t, place, stated[:, axis], axis) for axis in (0, 1)])


def _running_mean(t: Array, values: Array) -> Array:
    """The mean of values (N,2) within _NEAR s of each time."""
    low, high = np.searchsorted(t, t - _NEAR), np.searchsorted(t, t + _NEAR, side="right")
    running = np.vstack([np.zeros(2), np.cumsum(values, axis=0)])
    return np.asarray((running[high] - running[low]) / (high - low)[:, None])


def _scale(t: Array, place: Array, std: Array, axis: int) -> float:
    """Scatter over stated std: the least over several orders of difference, as motion only ever adds to one."""
    found = [_deviation(_residuals(t, place, std, axis, order)) for order in _ORDERS]
    scale = min(found)
    return scale if 0 < scale < _MOST else 1.0


def _residuals(t: Array, place: Array, std: Array, axis: int, order: int) -> Array:
    """Divided differences of that order over what std makes of them, where the target is seen and moves."""
    if len(t) <= order:
        return np.zeros(0)
    windows = np.lib.stride_tricks.sliding_window_view
    step = np.hypot(*np.diff(place, axis=0).T)
    moves = windows(step, order).mean(axis=1) > _STEP
    times, places, stds = (windows(each, order + 1)[moves] for each in (t, place[:, axis], std))
    apart = (times[:, :, None] - times[:, None, :]) / np.maximum(times[:, -1:, None] - times[:, :1, None], 1e-9)
    weight = 1 / np.maximum(np.abs(np.prod(apart + np.eye(order + 1), axis=2)), 1e-12)
    weight *= (-1.0) ** np.arange(order + 1)
    return np.asarray((weight * places).sum(axis=1) / np.sqrt((weight**2 * stds**2).sum(axis=1)))


def _deviation(values: Array) -> float:
    """Root mean square without outliers (a path has corners), infinite for too few values."""
    if len(values) < _ENOUGH:
        return np.inf
    scale = float(np.median(np.abs(values))) / 0.6745
    for _ in range(10):
        scale = float(np.sqrt(np.mean(values[np.abs(values) <= _OUTLIER * scale] ** 2)))
    return scale

"""Jumping encoders, found in their own readings: the level shifts faster than a joint can move."""

from math import tau

import numpy as np

from ...types import Array
from ..measurements.long_arrays import median, median_step, rows
from .threshold import LEAST, NATS

JUMP = 12.0
"""Smallest jump in standard deviations of the readings' steps."""
LEVEL = 5
"""Readings on each side of a jump that give its size."""
PAUSE = 3.0
"""Median steps in time: after a longer gap the joint may have moved to the new reading."""
FASTEST = 1000.0
"""rad/s²: largest acceleration of a joint; the fastest parallel robots reach a third of it at 1 m (15 g at 0.5 m)."""
HELD, OFTEN = 0.1, 3
"""s: longest time for which a driver may hold a reading, and steps needed to recognise that it does."""
BESIDE = 0.5
"""rad: a shift within BESIDE of a whole turn is a wrapped angle, not a fault."""


def jumps(t: Array, y: Array) -> list[tuple[int, float]]:
    """Return first index after each lasting shift in level of y (N,) rad at t (N,) s, and its size (rad)."""
    known = rows(np.isfinite(y))
    v, when, found = y[known], t[known], []
    if len(v) < 4 * LEVEL:
        return []
    steps, usual = np.diff(v), median_step(when)
    bound = _largest_sound(steps, when, usual)
    far = np.flatnonzero(np.abs(steps) > bound)
    for k in far[when[far + 1] - when[far] < PAUSE * usual]:
        if abs(size := _shift(v, int(k))) > bound:
            found.append((int(np.searchsorted(t, when[k + 1])), size))
    return found


def jump_nats(t: Array, y: Array) -> float:
    """Nats that a jump at the largest step of y (N,) rad at t (N,) s wins; the largest sound step would win NATS."""
    known = rows(np.isfinite(y))
    v, when = y[known], t[known]
    if len(v) < 4 * LEVEL:
        return 0.0
    steps, usual = np.diff(v), median_step(when)
    far = int(np.where(np.diff(when) < PAUSE * usual, np.abs(steps), 0.0).argmax())
    return NATS * (_shift(v, far) / _largest_sound(steps, when, usual)) ** 2


def _largest_sound(steps: Array, when: Array, usual: float) -> float:
    """Largest step (rad) of a sound encoder, from steps (N-1,) rad at `when` (N,) s, `usual` s apart."""
    # from rest to rest in a time h takes 4 s/h²
    fastest = FASTEST * max(usual, _hold_time(steps, when)) ** 2 / 4.0
    return max(JUMP * _scatter(steps), LEAST, fastest)


def _shift(v: Array, k: int) -> float:
    """Shift in level (rad) of readings v (N,) after the k-th; 0 if they change as much beside it, or are too few."""
    before, after = v[max(0, k + 1 - LEVEL) : k + 1], v[k + 1 : k + 1 + LEVEL]
    if len(before) < LEVEL or len(after) < LEVEL:
        return 0.0
    size = _level(after[::-1]) - _level(before)
    apart = max(float(np.abs(np.diff(before)).max()), float(np.abs(np.diff(after)).max()))
    return size if apart < abs(size) / 2 else 0.0


def unwrapped(y: Array) -> Array:
    """Return readings y (N,) rad, NaN where missing, with whole turns between neighbours removed."""
    if not np.fmax.reduce(y, initial=-np.inf) - np.fmin.reduce(y, initial=np.inf) > tau - BESIDE:
        return y
    known = np.isfinite(y)
    steps = np.diff(y[known], prepend=y[known][:1])
    whole = np.abs(np.abs(steps) - tau) < BESIDE
    found = y.copy()
    found[known] -= np.cumsum(np.where(whole, np.sign(steps) * tau, 0.0))
    return found


def _hold_time(steps: Array, t: Array) -> float:
    """Time (s) for which the driver holds a reading, from steps (N-1,) rad at t (N,) s; 0 if it does not."""
    sizes = np.abs(steps)
    if 2 * np.count_nonzero(steps) > len(steps):
        return 0.0
    moved = np.flatnonzero(sizes > 1.5 * sizes[sizes > 0.0].min(initial=np.inf))
    if len(moved) <= OFTEN:
        return 0.0
    return min(float(np.quantile(np.diff(t[moved]), 0.1)), HELD)


def _scatter(steps: Array) -> float:
    """Robust std of steps (N,) rad; for coarse encoders, whose median step is 0, the median nonzero step."""
    if scatter := 1.4826 * median(np.abs(steps - median(steps))):
        return scatter
    moved = np.abs(steps[steps != 0.0])
    return median(moved) if len(moved) else 0.0


def _level(v: Array) -> float:
    """Level of a short piece at its last reading, by a straight line."""
    return float(np.polyfit(np.arange(1 - len(v), 1), v, 1)[1])

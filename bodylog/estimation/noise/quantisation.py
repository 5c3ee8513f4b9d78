"""Quantised encoders: readings that repeat exactly
predict each other, which is no evidence of low noise.
"""

from math import tau
from typing import NamedTuple

import numpy as np

from ...types import Array

MULTIPLE_TOLERANCE = 0.02
"""Mean distance of steps from multiples of the least one,
over it, up to which it is the encoder's; by chance, ¼.
"""
SHARED_ERROR_S = 0.15
"""s: where a reading repeats for longer, motion does
not average its error, and the readings share it.
"""
MOST_INDEPENDENT = 7.5
"""Readings as which a joint at rest counts, those of SHARED_ERROR_S at 50 Hz: a higher rate tells
no more of where between two counts the joint is. Without it arms at rest have NEES of up to 36 and
reaches of up to 3.4, at 500 Hz with noise of a twentieth of a count; with 1, reaches err by 1.1 to
2.3 times as much.
"""
REMEMBERED_S = 4.0
"""s: what is remembered of a joint at rest. Longer stays count as fewer readings: without, smoothed
angles of arms that rest for 16 s have NEES of up to 5.9, where noise is a fifth of a count at 500
Hz (12 logs; with it 2.1), and the `filter` errs by a third less there.
"""
SAME_READING = 1e-12
"""rad: readings that differ by less are the same, up to the rounding of their units."""


def _mark_changes(y: Array) -> Array:
    """Whether each of readings (N,) differs from the one before it (N-1,)."""
    return np.asarray(np.abs(np.diff(y)) > SAME_READING)


def find_reading_step(y: Array) -> float:
    """The step (rad) of which all differences of readings (N,) are multiples; 0 without one."""
    steps = np.abs(np.diff(y))
    steps = steps[steps > SAME_READING]
    if not len(steps):
        return 0.0
    least = float(steps.min())
    counts = steps / least
    return least if np.abs(counts - np.round(counts)).mean() < MULTIPLE_TOLERANCE else 0.0


def compute_rest_factor(t: Array) -> float:
    """Factor on the variance of readings at t (N,) s that never change: they share one error."""
    return max(1.0, min(float(t[-1] - t[0]) / SHARED_ERROR_S, len(t)))


def compute_repeat_factor(t: Array, y: Array) -> float:
    """Factor on the variance of readings (N,) for errors that repeats share; 1 without repeats."""
    runs = 1 + np.count_nonzero(_mark_changes(y))
    return float(_count_sharing(np.array((t[-1] - t[0]) / runs), np.array(len(y) / runs)))


def dither_readings(t: Array, y: Array) -> tuple[Array, float, float]:
    """Readings (N,) dithered over their step, the
    variance (rad²) of the dither, and the least variance.
    """
    step = find_reading_step(y)
    least = compute_quantisation_variance(y) * compute_repeat_factor(t, y)
    if step == 0.0:
        return y, 0.0, least
    dithered = y + step * np.random.default_rng(0).uniform(-0.5, 0.5, len(y))
    return dithered, step * step / 12.0, least


def compute_relative_variances(t: Array, y: Array, variance: float) -> Array:
    """Variance of each reading (N,) over the encoder's
    `variance` (rad²); repeats at rest count as few readings.
    """
    own = compute_quantisation_variance(y)
    if own == 0.0:  # readings never repeat, or never change
        return np.ones(len(y))
    repeat_factor = compute_repeat_factor(t, y)
    beside = max(variance - own * (repeat_factor - 1.0), own)
    stays = _find_stays(t, y)
    more = own * stays.share * (_count_sharing(stays.lasting, stays.counts) - 1.0)
    return np.asarray(np.repeat(beside + more, stays.counts) / variance)


def weigh_as_one(t: Array, y: Array) -> Array:
    """Variance of each reading (N,) over that of one alone, where all of a stay are one reading."""
    stays = _find_stays(t, y)
    return np.asarray(np.repeat(1.0 + stays.share * (stays.counts - 1.0), stays.counts))


def _count_sharing(lasting: Array, counts: Array) -> Array:
    """How many readings have one error, of stays of so many seconds and readings.

    A filter of white acceleration remembers m^¼ s of readings of m times their variance, where it
    remembers MAX_MEMORY_S of sound ones. In that time, 2 m^¼ s for a smoother, 1/m of a rate r
    counts as one reading at m = (2 r)^(4/3): no stay tells less, however long it is.
    """
    times = lasting / SHARED_ERROR_S
    most = counts / MOST_INDEPENDENT * np.maximum(1.0, lasting / REMEMBERED_S)
    sharing = np.maximum(times, np.minimum(np.square(times), most))
    # a reading alone lasts no time
    most_remembered = (2.0 * counts / np.maximum(lasting, 1e-9)) ** (4.0 / 3.0)
    return np.maximum(1.0, np.minimum(sharing, np.minimum(counts, most_remembered)))


class Stays(NamedTuple):
    """Stretches of readings, during each of which a joint moves by less than a count.

    counts (S,) readings, that last (S,) s · share of the variance of rounding that readings of one
    place have in common, and do not average.
    """

    counts: Array
    lasting: Array
    share: float


def _find_stays(t: Array, y: Array) -> Stays:
    """The stays of readings y (N,) at t (N,) s: runs of repeats where these are no whole counts."""
    step = find_reading_step(y)
    begins = np.flatnonzero(np.append(True, _mark_changes(y)))
    places = np.round((y - y[0]) / (step or 1.0))
    if step > 0.0:
        begins = index_moves(_average_nearby(t, places))
    counts = np.diff(begins, append=len(y))
    lasting = t[np.minimum(begins + counts, len(y) - 1)] - t[begins]
    rests = lasting > SHARED_ERROR_S
    resting = np.repeat(rests, counts)
    pairs = np.diff(y)[resting[1:] & resting[:-1]]
    if step == 0.0 or not len(pairs):
        return Stays(counts, lasting, 1.0)
    share = _compute_common_share(0.5 * float(np.mean(np.square(pairs))) / step**2)
    spans = np.maximum.reduceat(places, begins) - np.minimum.reduceat(places, begins)
    if (spans[rests] < 2.0).all():
        # little noise moves as many where a place is at the edge of a count: few places do not tell
        share += (1.0 - share) / np.count_nonzero(rests) ** 2
    return Stays(counts, lasting, share)


def _average_nearby(t: Array, y: Array) -> Array:
    """Means (N,) of readings within SHARED_ERROR_S: noise moves each to the next count and back."""
    half = 0.5 * SHARED_ERROR_S
    begin, end = np.searchsorted(t, [t - half, t + half], "right")
    sums = np.append(0.0, np.cumsum(y))
    return np.asarray((sums[end] - sums[begin]) / (end - begin))


def index_moves(places: Array) -> Array:
    """Indices of the first of places (N,), and of each that is 1 or more from the last of these."""
    found = [0]
    last = places[0]
    for k, place in enumerate(places.tolist()):
        if abs(place - last) >= 1.0:
            found.append(k)
            last = place
    return np.array(found)


def _compute_common_share(scatter: float) -> float:
    """Share of the variance of rounding that readings of one place have in common, where these
    scatter by `scatter` squared counts.

    Noise of v squared counts leaves a place's own error, whose mean square over all places is
    Σ exp(−(2πk)² v) / 2π²k², k = 1, 2, … (Widrow and Kollár 2008). Readings scatter by the rest of
    v + 1/12.
    """
    v = np.append(0.0, np.geomspace(1e-4, 1.0, 60))
    k = np.arange(1, 200)[:, None]
    shares = (6.0 / np.square(np.pi * k) * np.exp(-np.square(tau * k) * v)).sum(axis=0)
    return float(np.interp(scatter, v + (1.0 - shares) / 12.0, shares))


def compute_quantisation_variance(y: Array) -> float:
    """Variance (rad²) of quantisation by the step, or by
    the least change if readings repeat; 0 if neither.
    """
    steps = np.abs(np.diff(y))
    moved = steps[steps > SAME_READING]
    step = find_reading_step(y) or (float(moved.min()) if 0 < len(moved) < len(steps) else 0.0)
    return step * step / 12.0

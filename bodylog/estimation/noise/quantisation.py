"""Quantised encoders: readings that repeat exactly
predict each other, which is no evidence of low noise.
"""

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


def step_size(y: Array) -> float:
    """The step (rad) of which all differences of readings (N,) are multiples; 0 without one."""
    steps = np.abs(np.diff(y))
    steps = steps[steps > 1e-12]
    if not len(steps):
        return 0.0
    counts = steps / steps.min()
    return (
        float(steps.min()) if np.abs(counts - np.round(counts)).mean() < MULTIPLE_TOLERANCE else 0.0
    )


def shared_variance(t: Array, y: Array) -> float:
    """Factor on the variance of readings (N,) for
    the errors that repeats share; 1 without repeats.
    """
    runs = 1 + np.count_nonzero(np.diff(y))
    return max(1.0, min(float(t[-1] - t[0]) / runs / SHARED_ERROR_S, len(y) / runs))


def dither_readings(t: Array, y: Array) -> tuple[Array, float, float]:
    """Readings (N,) dithered over their step, the
    variance (rad²) of the dither, and the least variance.
    """
    step = step_size(y)
    least = quantisation_variance(y) * shared_variance(t, y)
    if step == 0.0:
        return y, 0.0, least
    return y + step * np.random.default_rng(0).uniform(-0.5, 0.5, len(y)), step * step / 12.0, least


def relative_variances(t: Array, y: Array, variance: float) -> Array:
    """Variance of each reading (N,) over the encoder's
    `variance` (rad²); repeats at rest count as one reading.
    """
    own = quantisation_variance(y) or variance / shared_variance(t, y)
    runs = np.flatnonzero(np.append(True, np.diff(y) != 0.0))
    counts = np.diff(runs, append=len(y))
    lasting = t[np.minimum(runs + counts, len(y) - 1)] - t[runs]
    shared = np.clip(lasting / SHARED_ERROR_S, 1.0, counts)
    beside = max(variance - own * (shared_variance(t, y) - 1.0), own)
    return np.asarray(np.repeat(beside + own * (shared - 1.0), counts) / variance)


def quantisation_variance(y: Array) -> float:
    """Variance (rad²) of quantisation by the step, or by
    the least change if readings repeat; 0 if neither.
    """
    steps = np.abs(np.diff(y))
    moved = steps[steps > 0.0]
    step = step_size(y) or (float(moved.min()) if 0 < len(moved) < len(steps) else 0.0)
    return step * step / 12.0

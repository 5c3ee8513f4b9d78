"""Masks, steps and noise of long arrays."""

import numpy as np

from ...types import Array

MIN_READINGS = 30
"""Readings from which a variance is known to a fourth,
√(2/N): from fewer, neither noise nor a delay is sure.
"""
LEVEL_READINGS = 5
"""Readings on each side that show a level: its shift is
a jump, and a step that differs from it may be false.
"""
NOISE_READINGS = 6000
"""Readings from which noise is estimated, those in the middle of a log: more take longer, and these
tell a variance to a few percent.
"""


def find_finite_rows(values: Array) -> Array:
    """Which rows (N,) of values (N,D) are finite throughout."""
    return np.asarray(np.isfinite(values).all(axis=1))


def index_true_rows(mask: Array) -> Array | slice:
    """Index of the rows where mask (N,) is True: a
    slice, which copies nothing, if that is all of them.
    """
    return slice(None) if mask.all() else np.flatnonzero(mask)


def measure_median_step(t: Array) -> float:
    """Median difference of neighbours in t (N,), N > 1."""
    return float(np.median(np.diff(t)))


def estimate_noise_variance(values: Array) -> Array:
    """Variance (M,) of white noise in values (N,M), from
    third differences of NOISE_READINGS of them in the middle.
    """
    begin = max(0, (len(values) - NOISE_READINGS) // 2)
    # readings of several topics are in separate rows, with NaN between them
    columns = [column[np.isfinite(column)] for column in values[begin : begin + NOISE_READINGS].T]
    jerks = [
        np.median(np.abs(np.diff(column, 3))) if len(column) > 3 else np.nan for column in columns
    ]
    # a normal σ has the median size 0.6745 σ; third differences of white noise have 20 times its
    # variance: 1 + 9 + 9 + 1
    return np.asarray(np.square(1.4826 * np.array(jerks)) / 20.0)

"""Frozen encoders, found in their own readings: a noisy encoder that repeats one value for long.

An encoder at rest repeats its reading, too, if it counts in steps or is read only after motion. So repeats count as a
fault only for encoders that are noisy all the time, at rest and in motion.
"""

import numpy as np

from ...types import Array
from ..noise.quantisation import step_size

FROZEN, FEWEST = 0.5, 10
"""s and readings: shortest stretch of one repeated value that may be a freeze."""
RARE = 0.02
"""Largest share of repeats among other readings; above it, the encoder counts in steps and may be at rest."""
ROUNDED = 1.35
"""Steps: rounding alone scatters second differences by √(6/12) = 0.7 of a step, noise of one step by √6.5 = 2.5."""
WINDOW, STEADY = 16, 0.2
"""Readings per window, and the smallest scatter of a window over the median one; less means noise ends at rest."""


def frozen(t: Array, y: Array) -> list[tuple[int, int]]:
    """Return stretches [begin, end) of readings y (N,) rad at t (N,) s where a noisy encoder repeats itself exactly."""
    long = repeats(t, y)
    if not long or not noisy(np.delete(y, np.concatenate([np.arange(*run) for run in long]))):
        return []
    return [(begin + 1, end) for begin, end in long]  # the first of the repeated values was sound


def repeats(t: Array, y: Array) -> list[tuple[int, int]]:
    """Return long stretches [begin, end) of bitwise equal readings y (N,) at t (N,) s, the first one included."""
    same = np.diff(y) == 0.0
    if np.count_nonzero(same) < FEWEST - 1:
        return []
    edges = np.diff(same.astype(np.int8), prepend=0, append=0)
    runs = zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) + 1, strict=True)
    return [(int(a), int(b)) for a, b in runs if t[b - 1] - t[a] > FROZEN and b - a >= FEWEST]


def noisy(y: Array) -> bool:
    """Whether readings (N,) scatter all the time and rarely repeat, judged by sign changes of second differences."""
    y = y[np.isfinite(y)]
    bends = np.diff(y, 2)
    if len(bends) < 10 or np.mean(np.diff(y) == 0.0) > RARE or np.mean(bends[1:] * bends[:-1] < 0) <= 0.4:
        return False
    width = min(WINDOW, len(bends))
    scatter = np.sqrt(np.square(bends[: len(bends) // width * width].reshape(-1, width)).mean(axis=1))
    usual = float(np.median(scatter))
    return bool(scatter.min() > STEADY * usual) and usual > ROUNDED * step_size(y)

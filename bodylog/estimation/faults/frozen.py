"""Encoders that froze, by their own readings alone: noise that never let a reading repeat is gone for long.

A resting joint repeats its reading as well, where the encoder counts in steps or is read only when it moved. So repeats
alone accuse nobody: the encoder must be one that scatters all the time, at rest as in motion.
"""

import numpy as np

from ...types import Array

FROZEN, FEWEST = 0.5, 10
"""s, and readings: an encoder that repeats one value exactly for longer may be frozen."""
RARE = 0.02
"""Share of the other readings at most that repeat the one before: above, the encoder counts in steps and may rest."""
WINDOW, STEADY = 16, 0.2
"""Readings in a row, and their scatter over the usual one, at least: where it vanishes at times, it does so at rest."""


def frozen(t: Array, y: Array) -> list[tuple[int, int]]:
    """Stretches [begin, end) of readings y (N,) rad at t (N,) s in which a noisy encoder repeats itself exactly."""
    long = repeats(t, y)
    if not long or not noisy(np.delete(y, np.concatenate([np.arange(*run) for run in long]))):
        return []
    return [(begin + 1, end) for begin, end in long]  # the value it froze at was still sound


def repeats(t: Array, y: Array) -> list[tuple[int, int]]:
    """Stretches [begin, end) of readings y (N,) that are the same to the last bit for long, the first one included."""
    same = np.concatenate([[False], np.diff(y) == 0.0, [False]])
    edges = np.diff(same.astype(np.int8))
    runs = zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) + 1, strict=True)
    return [(int(a), int(b)) for a, b in runs if t[b - 1] - t[a] > FROZEN and b - a >= FEWEST]


def noisy(y: Array) -> bool:
    """Whether readings (N,) scatter all the time, and hardly ever repeat: their bends change sign at every turn."""
    y = y[np.isfinite(y)]
    bends = np.diff(y, 2)
    if len(bends) < 10 or np.mean(np.diff(y) == 0.0) > RARE or np.mean(bends[1:] * bends[:-1] < 0) <= 0.4:
        return False
    width = min(WINDOW, len(bends))
    scatter = np.sqrt(np.square(bends[: len(bends) // width * width].reshape(-1, width)).mean(axis=1))
    return bool(scatter.min() > STEADY * np.median(scatter))

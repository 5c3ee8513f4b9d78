"""The step an encoder counts in: readings that repeat exactly foretell each other, which is no proof of their noise."""

import numpy as np

from ...types import Array

WHOLE, MOST = 0.02, 0.95
"""How near to whole numbers of the least step the others must be, and which share of them."""
ONE = 0.15
"""s: where one reading repeats for longer, motion no longer averages its error away, and the readings share it."""


def grain(y: Array) -> float:
    """The step (rad) of which all steps between readings (N,) are multiples; 0 where there is none."""
    steps = np.abs(np.diff(y))
    steps = steps[steps > 1e-12]
    if not len(steps):
        return 0.0
    counts = steps / steps.min()
    return float(steps.min()) if np.mean(np.abs(counts - np.round(counts)) < WHOLE) > MOST else 0.0


def repeated(t: Array, y: Array) -> float:
    """How many times their variance readings (N,) have that share their errors, as repeats do; 1 without repeats."""
    runs = 1 + np.count_nonzero(np.diff(y))
    return max(1.0, min(float(t[-1] - t[0]) / runs / ONE, len(y) / runs))


def dithered(t: Array, y: Array) -> tuple[Array, float, float]:
    """Readings (N,) spread evenly over the step they were counted in, the variance (rad²) of that, and their least."""
    step = grain(y)
    if step == 0.0:
        return y, 0.0, resolved(y) * repeated(t, y)
    variance = step * step / 12.0
    spread = y + step * np.random.default_rng(0).uniform(-0.5, 0.5, len(y))
    return spread, variance, variance * repeated(t, y)


def relative(t: Array, y: Array, variance: float) -> Array:
    """Variance of each reading (N,) over the encoder's, `variance` (rad²): what repeats at rest is one reading."""
    own = resolved(y) or variance / repeated(t, y)
    runs = np.flatnonzero(np.append(True, np.diff(y) != 0.0))
    counts = np.diff(runs, append=len(y))
    lasting = t[np.minimum(runs + counts, len(y) - 1)] - t[runs]
    shared = np.clip(lasting / ONE, 1.0, counts)
    beside = max(variance - own * (repeated(t, y) - 1.0), own)
    return np.asarray(np.repeat(beside + own * (shared - 1.0), counts) / variance)


def resolved(y: Array) -> float:
    """Variance (rad²) of counting readings (N,) in steps, or in least changes where they repeat; 0 if neither."""
    steps = np.abs(np.diff(y))
    moved = steps[steps > 0.0]
    step = grain(y) or (float(moved.min()) if 0 < len(moved) < len(steps) else 0.0)
    return step * step / 12.0

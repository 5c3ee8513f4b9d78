"""Figures of episodes beside those of their siblings: the pooled mean with its jitter, and those that stand out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..types import Array

FALSE_ALARMS = 0.01
"""Chance that any sound episode of a dataset stands out in any figure."""
LEAST_EPISODES = 5
"""Fewest episodes of which one can stand out: of fewer, the spread of the others is not known."""
LARGEST_SHARE = 0.3
"""Largest share of episodes that can stand out; more are another kind of episode, no outliers."""
_ROUNDS = 50


@dataclass(frozen=True)
class Pooled:
    """A figure over episodes: mean, its standard error, and the jitter, the standard deviation between episodes that
    the figures' own errors do not explain."""

    mean: float
    std: float
    jitter: float


@dataclass(frozen=True)
class Outlier:
    """An episode (by number) whose figure stands out: value, the mean and spread of the others, the distance in
    standard deviations `z`, and the `bound` that it exceeds."""

    number: int
    value: float
    others: float
    spread: float
    z: float
    bound: float


def pool(values: Array, std: Array) -> Pooled:
    """The random-effects mean of values (N,) with standard errors (N,), by Paule & Mandel (1982).

    The jitter τ² is that for which Σ (x − μ)² / (σ² + τ²) = N − 1; where Σ is less without it, it is 0. The mean's
    error is scaled by what is left of that sum (Hartung & Knapp 2001), never below the value for it.
    """
    if len(values) == 1:
        return Pooled(float(values[0]), float(std[0]), 0.0)
    low, high = 0.0, float(np.ptp(values)) ** 2
    if _misfit(values, std, low)[0] <= len(values) - 1:
        high = 0.0
    for _ in range(_ROUNDS):
        middle = 0.5 * (low + high)
        if _misfit(values, std, middle)[0] > len(values) - 1:
            low = middle
        else:
            high = middle
    jitter2 = high
    misfit, mean, information = _misfit(values, std, jitter2)
    scale = max(1.0, misfit / (len(values) - 1))
    return Pooled(mean, float(np.sqrt(scale / information)), float(np.sqrt(jitter2)))


def _misfit(values: Array, std: Array, jitter2: float) -> tuple[float, float, float]:
    """Squared errors over their variances, the weighted mean, and its information."""
    weights = 1.0 / np.maximum(std**2 + jitter2, 1e-24)
    mean = float((weights * values).sum() / weights.sum())
    return float((weights * (values - mean) ** 2).sum()), mean, float(weights.sum())


def find_outliers(values: Array, std: Array, resolution: float, looks: int) -> list[Outlier]:
    """Episodes whose values (N,) stand out, by the generalised extreme studentised deviate test (Rosner 1983).

    Each value is compared with the mean and spread of the others; the farthest leaves, and so on, so that several
    outliers do not hide each other. The bound is Student's, for FALSE_ALARMS over all `looks`, the number of figures
    of the dataset. std (N,): standard errors · resolution: the least spread that is believed.
    """
    from scipy.special import stdtrit

    rest = np.flatnonzero(np.isfinite(values))
    if len(rest) < LEAST_EPISODES:
        return []
    removed: list[tuple[int, float, float]] = []
    last = 0
    for _ in range(max(1, int(LARGEST_SHARE * len(rest)))):
        z = _distances(values[rest], std[rest], resolution)
        farthest = int(np.argmax(z))
        bound = float(-stdtrit(len(rest) - 2, 0.5 * FALSE_ALARMS / max(looks, 1)))
        removed.append((int(rest[farthest]), float(z[farthest]), bound))
        if z[farthest] > bound:
            last = len(removed)
        rest = np.delete(rest, farthest)
    chosen = removed[:last]
    numbers = [number for number, _, _ in chosen]
    others = np.delete(values, numbers)
    others = others[np.isfinite(others)]
    mean, spread = float(others.mean()), float(others.std(ddof=1))
    # the first distances may be short beside further outliers: all are told against the sound ones
    scale = np.hypot(np.hypot(spread, resolution), std)
    return [
        Outlier(number, float(values[number]), mean, spread, abs(float(values[number]) - mean) / scale[number], bound)
        for number, _, bound in chosen
    ]


def _distances(values: Array, std: Array, resolution: float) -> Array:
    """Distances (N,) of values from the mean of the others, in standard deviations of a further value."""
    count = len(values)
    total = values.sum()
    means = (total - values) / (count - 1)
    found = np.empty(count)
    for number in range(count):
        others = np.delete(values, number)
        variance = float(others.var(ddof=1)) * (1.0 + 1.0 / (count - 1))
        own = max(0.0, float(std[number] ** 2 - np.mean(np.delete(std, number) ** 2)))
        found[number] = abs(values[number] - means[number]) / np.sqrt(variance + own + resolution**2)
    return found


def without_nan(std: Sequence[float | None]) -> Array:
    """Standard errors (N,), 0 where there is none."""
    return np.array([0.0 if one is None else one for one in std])

"""Figures of episodes beside those of their siblings: the pooled mean with its jitter, and those
that stand out."""

from dataclasses import dataclass

import numpy as np

from ..types import Array

FALSE_ALARMS = 0.01
"""Chance that any sound episode of a dataset stands out in any figure."""
LEAST_EPISODES = 5
"""Fewest episodes of which one can stand out: of fewer, the spread of the others is not known."""
LARGEST_SHARE = 0.3
"""Largest share of episodes that can stand out; more are another kind of episode, no outliers."""
STATED_READINGS = 6
"""Episodes as which stated standard errors count beside their misfit (the prior's degrees of
freedom of Smyth 2004): they are right within a third, and so is the spread of six."""
OTHER_DELAY_NATS = 30.0
"""Evidence for another delay than the siblings' from which an episode stands out: 304 sound
episodes of 38 cameras of drawn worlds reach 24.5 nats, and of 17 that are 0.1 to 0.2 s late each
reaches 35 and more, two of them without evidence for a delay of their own."""
_ROUNDS = 50


@dataclass(frozen=True)
class PooledFigure:
    """A figure over episodes: mean, its standard error, and the jitter, the standard deviation
    between episodes that the figures' own errors do not explain."""

    mean: float
    std: float
    jitter: float


@dataclass(frozen=True)
class Outlier:
    """An episode (by number) whose figure stands out: value, the mean and spread of the others, the
    distance in standard deviations `z`, and the `bound` that it exceeds."""

    number: int
    value: float
    others: float
    spread: float
    z: float
    bound: float


@dataclass(frozen=True)
class Step:
    """A figure that changes for good: `first` episode (by number) after the change, its size, the
    distance in standard deviations `z`, and the `bound` that it exceeds."""

    first: int
    size: float
    z: float
    bound: float


def pool_values(values: Array, std: Array) -> PooledFigure:
    """The random-effects mean of values (N,) with standard errors (N,), by Paule & Mandel (1982).

    The jitter τ² is that for which Σ (x − μ)² / (σ² + τ²) = N − 1; where Σ is less without it, it
    is 0. The mean's error is scaled by what is left of that sum (Hartung & Knapp 2001), never below
    the value for it.
    """
    if len(values) == 1:
        return PooledFigure(float(values[0]), float(std[0]), 0.0)
    low = 0.0
    high = float(np.ptp(values)) ** 2
    if _weighted_squared_errors(values, std, low)[0] <= len(values) - 1:
        high = 0.0
    for _ in range(_ROUNDS):
        middle = 0.5 * (low + high)
        if _weighted_squared_errors(values, std, middle)[0] > len(values) - 1:
            low = middle
        else:
            high = middle
    jitter2 = high
    misfit, mean, information = _weighted_squared_errors(values, std, jitter2)
    scale = max(1.0, misfit / (len(values) - 1))
    return PooledFigure(mean, float(np.sqrt(scale / information)), float(np.sqrt(jitter2)))


def _weighted_squared_errors(
    values: Array, std: Array, jitter2: float
) -> tuple[float, float, float]:
    """Squared errors over their variances, the weighted mean, and its information."""
    weights = 1.0 / np.maximum(std**2 + jitter2, 1e-24)
    mean = float((weights * values).sum() / weights.sum())
    return float((weights * (values - mean) ** 2).sum()), mean, float(weights.sum())


def find_outliers(values: Array, std: Array, resolution: float, looks: int) -> list[Outlier]:
    """Episodes whose values (N,) stand out, by the generalised extreme studentised deviate test
    (Rosner 1983).

    Each value is compared with the mean and spread of the others; the farthest leaves, and so on,
    so that several outliers do not hide each other. FALSE_ALARMS is shared by all `looks`, the
    number of figures of the dataset: the spread, which is estimated from few episodes, has
    Student's bound, and `resolution`, the least spread that is believed, the normal one. Where
    values have standard errors std (N,), the spread is these times what their misfit asks for.
    """
    rest = np.flatnonzero(np.isfinite(values))
    if len(rest) < LEAST_EPISODES:
        return []
    tail = 0.5 * FALSE_ALARMS / max(looks, 1)
    removed: list[Outlier] = []
    count = 0
    for _ in range(max(1, int(LARGEST_SHARE * len(rest)))):
        farthest = _find_farthest(values, std, rest, None, resolution, tail)
        removed.append(farthest)
        if farthest.z > farthest.bound:
            count = len(removed)
        rest = rest[rest != farthest.number]
    outliers = [one.number for one in removed[:count]]
    sound = np.setdiff1d(np.flatnonzero(np.isfinite(values)), outliers)
    # distances beside further outliers are short: each is reported as it is farthest
    alone = [
        _find_farthest(values, std, np.append(sound, k), len(sound), resolution, tail)
        for k in outliers
    ]
    pairs = zip(removed[:count], alone, strict=True)
    return [max(pair, key=lambda one: one.z / one.bound) for pair in pairs]


def _find_farthest(
    values: Array, std: Array, rest: Array, place: int | None, resolution: float, tail: float
) -> Outlier:
    """The value among `rest` that is farthest from the others there, or the one at a `place`."""
    others, spread, z, bound = _compare_with_others(values, std, rest, resolution, tail)
    k = int(np.argmax(z / bound)) if place is None else place
    number = int(rest[k])
    value = float(values[number])
    own = (float(column[k]) for column in (others, spread, z, bound))
    return Outlier(number, value, *own)


def find_other_delays(profiles: Array, delays: Array) -> list[Outlier]:
    """Episodes whose likelihood over delays has its top elsewhere than the others' have theirs.

    profiles (N,K): log likelihood (nats) of each episode at ascending delays (K,) s, one step
    apart; rows with NaN are left out. The others' profiles are summed, and each says at most
    OTHER_DELAY_NATS against a delay, so that no single one decides for them. Distances and bound
    are of a normal error with as many nats; delays up to a step apart are the same. Where more than
    LARGEST_SHARE of the episodes differ, the pictures tell no common delay, and none stands out.
    """
    known = np.flatnonzero(np.isfinite(profiles).all(axis=1))
    if len(known) < LEAST_EPISODES:
        return []
    lacking = profiles[known] - profiles[known].max(axis=1, keepdims=True)
    agreed = np.maximum(lacking, -OTHER_DELAY_NATS)
    step_s = float(delays[1] - delays[0])
    found = []
    for number, own, others in zip(
        known.tolist(), lacking, agreed.sum(axis=0) - agreed, strict=True
    ):
        common = int(np.argmax(others))
        nats = -float(own[max(common - 1, 0) : common + 2].max())
        if nats > OTHER_DELAY_NATS:
            best = int(np.argmax(own))
            sigma, bound = np.sqrt([2.0 * nats, 2.0 * OTHER_DELAY_NATS]).tolist()
            found.append(
                Outlier(number, float(delays[best]), float(delays[common]), step_s, sigma, bound)
            )
    return found if len(found) <= LARGEST_SHARE * len(known) else []


def find_step(values: Array, resolution: float, looks: int) -> Step | None:
    """The change for good that splits values (N,) in order best; None where none is significant.

    Both sides have at least two episodes, since one alone is an outlier. The spread is that of both
    sides about their means; bounds are those of `find_outliers`, shared by all splits as well.
    """
    from scipy.special import ndtri, stdtrit

    known = np.flatnonzero(np.isfinite(values))
    y = values[known]
    count = len(known)
    if count < LEAST_EPISODES:
        return None
    tail = 0.5 * FALSE_ALARMS / max(looks, 1) / (count - 3)
    student = float(-stdtrit(count - 2, tail))
    normal = float(-ndtri(tail))
    best: Step | None = None
    for k in range(2, count - 1):
        before = y[:k]
        after = y[k:]
        squares = np.square(before - before.mean()).sum() + np.square(after - after.mean()).sum()
        wide = (1.0 / k + 1.0 / (count - k)) ** 0.5
        spread = wide * float(np.sqrt(squares / (count - 2)))
        least = wide * resolution
        scale = float(np.hypot(spread, least))
        size = float(after.mean() - before.mean())
        bound = float(np.hypot(student * spread, normal * least)) / scale
        found = Step(int(known[k]), size, abs(size) / scale, bound)
        if best is None or found.z / found.bound > best.z / best.bound:
            best = found
    return best if best is not None and best.z > best.bound else None


def _compare_with_others(
    values: Array, std: Array, rest: Array, resolution: float, tail: float
) -> tuple[Array, Array, Array, Array]:
    """Each value among `rest` (K,) against the others there: their mean, its spread about this, its
    distance in spreads, and the bound, each (K,).

    Student's bound is for their spread, the normal one for known errors; `tail` is the chance of
    either to be exceeded.
    """
    from scipy.special import ndtri, stdtrit

    centre = float(np.median(values[rest]))
    y = values[rest] - centre
    own2 = std[rest] ** 2 + resolution**2
    count = len(rest) - 1
    freedom = max(count - 1, 1)
    mean, squares, information = _leave_each_out(y, 1.0 / own2)
    scale2 = (STATED_READINGS + squares) / (STATED_READINGS + freedom)
    spread = np.sqrt(scale2 * (own2 + 1.0 / information))
    bound = np.full(len(rest), float(-stdtrit(freedom + STATED_READINGS, tail)))
    unstated = _sum_of_others(np.where(std[rest] > 0.0, 0.0, 1.0)) > 0.0
    plain, squares, _ = _leave_each_out(y, np.ones(len(rest)))
    scatter = np.sqrt(squares / freedom * (1.0 + 1.0 / count))
    scale = np.sqrt(scatter**2 + own2)
    student = float(-stdtrit(freedom, tail))
    normal = float(-ndtri(tail))
    usual = np.sqrt((student * scatter) ** 2 + normal**2 * own2) / scale
    mean = np.where(unstated, plain, mean)
    z = np.abs(y - mean) / np.where(unstated, scale, spread)
    return (mean + centre, np.where(unstated, scatter, spread), z, np.where(unstated, usual, bound))


def _leave_each_out(y: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Of the others of each value y (K,): the weighted mean, squared errors and information."""
    information = _sum_of_others(weights)
    mean = _sum_of_others(weights * y) / information
    squares = _sum_of_others(weights * y**2) - information * mean**2
    return mean, np.maximum(squares, 0.0), information


def _sum_of_others(x: Array) -> Array:
    """Sum of all but one of x (K,), for each; without a difference, which a far value would
    spoil."""
    before = np.append(0.0, np.cumsum(x)[:-1])
    after = np.append(np.cumsum(x[::-1])[:-1][::-1], 0.0)
    return np.asarray(before + after)


def own_std(std: float | None, shared_std: float) -> float:
    """The part of a standard error that siblings do not share; 0 without one."""
    return 0.0 if std is None else float(np.sqrt(max(std**2 - shared_std**2, 0.0)))

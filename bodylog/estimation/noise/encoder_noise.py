"""Encoder noise and process noise of each joint, for white acceleration or jerk, by the evidence of its readings."""

from dataclasses import dataclass
from math import factorial

import numpy as np

from ...types import Array
from ..inference.folds import Fold
from ..measurements.records import Encoders
from .quantisation import dithered, shared_variance
from .sudden_motion import followed

TRIED = 45
"""Ratios tried, over all magnitudes; a parabola through the best of them is exact enough for the evidence."""
RANGE = {2: (1e-9, 1e6), 3: (1e-11, 1e6)}
"""Ratios of process to noise, per reading, by the motion's order."""
SPREADS = {
    order: [
        (i, j, 2 * order - 1 - i - j, (2 * order - 1 - i - j) * factorial(order - 1 - i) * factorial(order - 1 - j))
        for i in range(order) for j in range(order)
    ]
    for order in (2, 3)
}  # fmt: skip
"""Rows, columns, powers of time and divisors of the covariance that unit white noise in the last rate brings."""
LAGGING = 4.0
"""Standard deviations: three consecutive readings that are farther off mean that the filter lags."""
RAISED = 2.0
"""Factor on a density per step, until the filter keeps up."""
VAGUE = 1e8
"""Noise variances: initial variance of a filter."""
SPACING = 0.01
"""s: closer readings are averaged, because a short stretch shows no acceleration."""
MOST = 6000
"""Most averages used, from the middle of the log: more would not sharpen two numbers per joint."""
STRETCH = 512
"""Averages per stretch, all stretches being filtered in parallel; short stretches cannot show slow motion."""
SKIP = 10
"""Readings at the start of a stretch that do not count."""
FEWEST = 30
"""Readings of a joint that are too few to learn its noise."""
BREAK = 10.0
"""Robust standard deviations: a larger second difference is a jump, where the filter restarts."""
AROUND = 5
"""Second differences on each side among which a jump must stand out."""
MEMORY = 1.0
"""s: longest memory of a filter for a joint at rest."""
LEAST = 1e-12
"""rad²: least encoder variance, (1 µrad)², a twentieth of the step of a 19-bit encoder."""


@dataclass(frozen=True, eq=False)
class Learned:
    """encoder (M,) rad² · process (M,) for motion of an order · evidence (nats) of all joints."""

    order: int
    encoder: Array
    process: Array
    evidence: float


def learn(encoders: Encoders, encoder: Array, process: Array, order: int = 2) -> Learned:
    """Learn encoder variances and process densities by evidence; a joint with few readings keeps the given ones.

    Quantised readings are dithered over their step, whose variance is the least.
    """
    encoder, process, joints, nats = encoder.copy(), process.copy(), list[int](), 0.0
    series, coarse = list[tuple[Array, Array]](), list[list[float]]()
    for joint, column in enumerate(encoders.values.T):
        known = np.flatnonzero(np.isfinite(column))
        most = MOST * _fellows(encoders.t[known])
        begin = max(0, (len(known) - most) // 2)
        known = known[begin : begin + most]
        if len(known) > FEWEST and np.ptp(column[known]) > 0.0:
            joints.append(joint)
            spread, *own = dithered(encoders.t[known], column[known])
            series.append((encoders.t[known], spread))
            coarse.append(own)
        elif len(known):
            encoder[joint] *= shared_variance(encoders.t[known], column[known])
    if joints:
        found, density, won = likeliest(series, order)
        nats = float(won.sum())
        added, least = np.transpose(coarse)
        encoder[joints] = np.maximum(found - added, least)
        noise = np.maximum(found, encoder[joints])
        if order == 2:
            density = np.array([_followed(*one) for one in zip(series, noise, density, strict=True)])
        process[joints] = density
    return Learned(order, encoder, process, nats)


def _followed(series: tuple[Array, Array], noise: float, process: float) -> float:
    """Density that the motion in times and readings (N,) requires, at least `process`."""
    t, y = series
    return followed(t, y, _alone(np.abs(np.diff(y, 2))), noise, process)


def followable(encoders: Encoders, encoder: Array, process: Array) -> Array:
    """Densities (M,) rad²/s³, at least `process`, with which a filter follows all readings of the encoders."""
    process = process.copy()
    for joint, column in enumerate(encoders.values.T):
        known = np.isfinite(column)
        process[joint] = _followed((encoders.t[known], column[known]), encoder[joint], process[joint])
    return process


def floor(t: Array, encoder: Array, order: int) -> Array:
    """Least density (M,), which bounds a filter's memory, (R Δt / q)^(1/2p), by MEMORY; p is the motion's order."""
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    return np.asarray(encoder * step / MEMORY ** (2 * order))


def likeliest(series: list[tuple[Array, Array]], order: int = 2) -> tuple[Array, Array, Array]:
    """Noise variances and densities (M,) that maximise the evidence (M,) of each joint's times and readings."""
    fellows = np.array([_fellows(t) for t, _ in series])
    means = [_averaged(t, y, k) for (t, y), k in zip(series, fellows, strict=True)]
    folded = _side_by_side(means)
    step = np.array([float(np.median(np.diff(t))) for t, *_ in means])
    # process / noise variance, scaled so that 1 is balanced per reading
    ratios = np.geomspace(*RANGE[order], TRIED)[:, None] / step ** (2 * order - 1)
    score, noise, lag = evidence(*folded, ratios, order)
    nats = np.asarray(score.max(axis=0))
    ratio, variance = _peak(ratios, score, noise)
    if (lag[score.argmax(axis=0), np.arange(len(series))] > LAGGING).any():
        ratio = _followed_by(folded, ratio, variance, order)
    return variance * fellows, variance * ratio, nats


def _followed_by(folded: tuple[Array, Array, Array], ratio: Array, variance: Array, order: int) -> Array:
    """Ratios (M,), at least those given, with which a filter of noise variance (M,) keeps up with all motion."""
    raised = ratio * RAISED ** np.arange(24)[:, None]
    _, noise, lag = evidence(*folded, raised, order)
    off = lag * np.sqrt(noise / variance)
    keeps: Array = np.asarray(off <= LAGGING)
    return np.asarray(raised[np.where(keeps.any(axis=0), keeps.argmax(axis=0), len(raised) - 1), np.arange(len(ratio))])


def _peak(ratios: Array, score: Array, noise: Array) -> tuple[Array, Array]:
    """Ratios and noise (M,) at the greatest score (R,M), by a parabola through the best three."""
    at = np.clip(score.argmax(axis=0), 1, len(ratios) - 2), np.arange(ratios.shape[1])
    (r0, r1, r2), (s0, s1, s2), (n0, n1, n2) = (
        [a[at[0] + side, at[1]] for side in (-1, 0, 1)] for a in (np.log(ratios), score, np.log(noise))
    )
    bend = np.minimum(s0 - 2.0 * s1 + s2, -np.finfo(float).tiny)
    shift = np.clip(0.5 * (s0 - s2) / bend, -1.0, 1.0)
    return np.exp(r1 + 0.5 * shift * (r2 - r0)), np.exp(n1 + 0.5 * shift * (n2 - n0))


def _fellows(t: Array) -> int:
    """Readings per average."""
    step = float(np.median(np.diff(t))) if len(t) > 1 else SPACING
    return max(1, min(round(SPACING / max(step, 1e-9)), len(t) // FEWEST))


def _averaged(t: Array, y: Array, fellows: int) -> tuple[Array, Array, Array]:
    """Means (N,) of times and of readings, and where the filter restarts: at and after a mean with a break."""
    whole = len(t) // fellows * fellows
    broken = _breaks(t, y)
    t, y = (a[:whole].reshape(-1, fellows).mean(axis=1) for a in (t, y))
    if fellows > 1:
        broken = np.asarray(broken[:whole].reshape(-1, fellows).any(axis=1))
        broken[1:] |= broken[:-1]
        broken |= _breaks(t, y)
    return t, y, broken


def _side_by_side(series: list[tuple[Array, Array, Array]]) -> tuple[Array, Array, Array]:
    """Time steps, readings (NaN after the last) and restarts, folded: (L,M,C) each."""
    most = max(len(t) for t, *_ in series)
    dt, y, fresh = (
        np.zeros((most, len(series))),
        np.full((most, len(series)), np.nan),
        np.ones((most, len(series)), bool),
    )
    for joint, (t, column, breaks) in enumerate(series):
        rows = slice(len(t)), joint
        dt[rows], y[rows], fresh[rows] = np.diff(t, prepend=t[0]), column, breaks
    fold = Fold(most, STRETCH, -(-most // STRETCH))
    return fold.fold(dt, 0.0), fold.fold(y, np.nan), fold.fold(fresh, 1.0) > 0


def evidence(dt: Array, y: Array, fresh: Array, ratios: Array, order: int = 2) -> tuple[Array, Array, Array]:
    """Log evidence (R,M) per ratio process/noise (R,M), with the noise variance that maximises it given the ratio.

    For order 3 also the largest median (R,M) of three consecutive innovations, in standard deviations.
    """
    finite, count = np.isfinite(y), np.arange(len(y))[:, None, None]
    fresh = np.asarray(fresh | (count == 0))
    counts = np.asarray(finite & (count - np.maximum.accumulate(np.where(fresh, count, 0)) >= SKIP))
    begins = np.asarray(fresh.any(axis=(1, 2)))
    # readings with equal times and ratios have the same covariance, which is computed once
    first, which = _same_covariance(dt, finite, fresh, ratios)
    own_dt, own_counts, q = dt[:, first], counts[:, first], ratios[:, first, None]
    x, (squares, lag) = np.zeros((order, *ratios.shape, y.shape[2])), np.zeros((2, *ratios.shape, y.shape[2]))
    logs, recent = np.zeros((*q.shape[:2], y.shape[2])), np.zeros((3, *squares.shape))
    p, vague = np.zeros((order, order, *logs.shape)), _vague(own_dt, order, logs.shape)
    grown = [(row, column, own_dt**power / scale) for row, column, power, scale in SPREADS[order]]
    for i, h in enumerate(dt):
        _carry(x, h)
        _carry(p, own_dt[i])
        _carry(p.swapaxes(0, 1), own_dt[i])
        for row, column, unit in grown:
            p[row, column] += q * unit[i]
        if begins[i]:
            x[0], x[1:] = np.where(fresh[i], y[i], x[0]), np.where(fresh[i], 0.0, x[1:])
            p = np.where(fresh[i][first], vague, p)
        s, nu = p[0, 0] + 1.0, np.where(finite[i], y[i] - x[0], 0.0)
        gain = p[0] / s
        cost = nu * nu * (own_counts[i] / s)[:, which]
        squares += cost
        logs += own_counts[i] * np.log(s)
        if order > 2:
            recent[i % 3] = cost
            one, two, three = recent
            np.maximum(lag, np.maximum(np.minimum(one, two), np.minimum(np.maximum(one, two), three)), out=lag)
        x += gain[:, :, which] * nu
        p -= gain[:, None] * p[0].copy()[None]
        p[0] = p[:, 0] = gain
    n, misfit = np.maximum(counts.sum(axis=(0, 2)), 1.0), squares.sum(axis=2)
    noise = np.maximum(misfit / n, LEAST)
    score = -0.5 * (n * np.log(noise) + misfit / noise + logs.sum(axis=2)[:, which])
    return np.where(np.isfinite(score), score, -np.inf), noise, np.sqrt(lag.max(axis=2) / noise)


def _same_covariance(*parts: Array) -> tuple[Array, Array | slice]:
    """First column (U,) of each group that is equal in all parts (L,M,…), and each column's group (M,)."""
    keys = [b"".join(part[:, column].tobytes() for part in parts) for column in range(parts[0].shape[1])]
    numbers = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    first = np.array([keys.index(key) for key in numbers])
    return first, slice(None) if len(first) == 1 else np.array([numbers[key] for key in keys])


def _vague(dt: Array, order: int, shape: tuple[int, ...]) -> Array:
    """Initial covariance (S,S,…) of a filter, for the typical step of times dt (L,U,C)."""
    steps = np.array([np.median(own[own > 0]) for own in dt.swapaxes(0, 1)])[:, None] if order > 2 else 1.0
    vague = np.zeros((order, order, *shape))
    for state in range(order):
        vague[state, state] = VAGUE / steps ** (2 * state)
    return vague


def _carry(a: Array, h: Array) -> None:
    """Move states a (S,…) by a time h, in place."""
    for state in range(len(a) - 1):
        a[state] += h * a[state + 1]
        if state + 2 < len(a):
            a[state] += (0.5 * h * h) * a[state + 2]


def _breaks(t: Array, y: Array) -> Array:
    """Readings (N,) that cannot follow from their neighbours, where the filter restarts."""
    bend = np.abs(np.diff(y, 2))
    gap = np.diff(t) > 20.0 * np.median(np.diff(t))
    alone = _alone(bend)
    fresh = np.zeros(len(y), bool)
    fresh[1:-1] = alone
    fresh[2:] |= alone
    fresh[1:] |= gap
    return fresh


def _alone(bend: Array) -> Array:
    """Second differences (N,) that stand out of all others and of their neighbours; those of a starting arm do not."""
    moved = bend[bend > 0.0]
    # where most readings repeat, the others are typical
    typical = np.median(bend) if 2 * len(moved) > len(bend) else np.median(moved) if len(moved) else np.inf
    found = bend > BREAK * 1.4826 * typical
    at = np.flatnonzero(found)
    around = np.pad(bend, AROUND)[at[:, None] + np.arange(2 * AROUND + 1)]
    found[at] = bend[at] > BREAK * np.median(around, axis=1)
    return np.asarray(found)

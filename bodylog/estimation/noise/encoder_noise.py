"""Encoder noise and process noise of each joint, for white acceleration or jerk, by the evidence of its readings."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ...types import Array
from ..inference.filter_records import GATE
from ..measurements.long_arrays import median, median_step
from ..measurements.records import Encoders
from .encoder_evidence import evidence
from .quantisation import dithered, shared_variance
from .visibility import LONG

SPACING = 0.01
"""s: closer readings are averaged, because a short stretch shows no acceleration."""
MOST = 6000
"""Most averages used, from the middle of the log: more would not sharpen two numbers per joint."""
STRETCH = 256
"""Averages per stretch, all stretches being filtered in parallel, each warmed up by the one before; and twice the
longest memory tried. A vague start would count against white jerk, which takes longer to settle. Of 180 joints at rest
for 12 to 60 s, stretches of 128, 256 and 384 give 39, 4 and 1 % a process density above the `floor`; logs of motion
have the same errors with 128 and 256."""
TRIED = 45
"""Memories tried, four per octave; a parabola through the best of them is exact enough for the evidence."""
FEWEST = 30
"""Readings of a joint that are too few to learn its noise."""
BREAK = 10.0
"""Robust standard deviations: a larger second difference is a false reading, where the filter restarts."""
AROUND = 5
"""Second differences on each side among which a false reading must stand out."""
MEMORY = 1.0
"""s: longest memory of a filter for a joint at rest."""


@dataclass(frozen=True, eq=False)
class Learned:
    """encoder (M,) rad², also of readings dithered · process (M,) for motion of an order · evidence (nats) of all."""

    order: int
    encoder: Array
    dithered: Array
    process: Array
    evidence: float


def learn(encoders: Encoders, encoder: Array, process: Array, order: int = 2, known: Array | None = None) -> Learned:
    """Learn encoder variances and process densities by evidence; a joint with few readings keeps the given ones.

    Quantised readings are dithered over their step, whose variance is the least.
    known (M,) rad²: variances of the dithered readings, for which only process densities are learned.
    """
    encoder, found, process, joints, nats = encoder.copy(), encoder.copy(), process.copy(), list[int](), 0.0
    series, coarse = list[tuple[Array, Array]](), list[list[float]]()
    for joint, column in enumerate(encoders.values.T):
        rows = np.flatnonzero(np.isfinite(column))
        most = MOST * _fellows(encoders.t[rows])
        begin = max(0, (len(rows) - most) // 2)
        rows = rows[begin : begin + most]
        if len(rows) > FEWEST and np.ptp(column[rows]) > 0.0:
            joints.append(joint)
            spread, *own = dithered(encoders.t[rows], column[rows])
            series.append((encoders.t[rows], spread))
            coarse.append(own)
        elif len(rows) and known is None:
            encoder[joint] *= shared_variance(encoders.t[rows], column[rows])
    if joints:
        added, least = np.transpose(coarse)
        found[joints], process[joints], won = likeliest(series, order, None if known is None else known[joints])
        nats = float(won.sum())
        encoder[joints] = np.maximum(found[joints] - added, least)
    return Learned(order, encoder, found, process, nats)


def followable(encoders: Encoders, encoder: Array, process: Array, order: int) -> Array:
    """Densities (M,), at least `process`, with which a filter of an order follows all readings of the encoders.

    Joints with few readings keep theirs.
    """
    known, process = np.isfinite(encoders.values), process.copy()
    joints = np.flatnonzero(known.sum(axis=0) > FEWEST)
    if len(joints):
        series = [(encoders.t[known[:, joint]], encoders.values[known[:, joint], joint]) for joint in joints]
        (folded, fellows, _), noise = _averages(series), encoder[joints]
        process[joints] = noise * _followed_by(folded, process[joints] / noise, noise / fellows, order)
    return process


def floor(t: Array, encoder: Array, order: int) -> Array:
    """Least density (M,), which bounds a filter's memory, (R Δt / q)^(1/2p), by MEMORY; p is the motion's order."""
    step = median_step(t) if len(t) > 1 else 0.0
    return np.asarray(encoder * step / MEMORY ** (2 * order))


def likeliest(
    series: list[tuple[Array, Array]], order: int = 2, known: Array | None = None
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Noise variances, unless `known`, and densities (M,) of most evidence (M,) of each joint's times and readings."""
    folded, fellows, step = _averages(series)
    # a ratio of 1 per average has a memory of one average
    per_average = (0.5 * STRETCH) ** (-2 * order) * 2.0 ** (0.5 * order * np.arange(TRIED))
    ratios = per_average[:, None] / step ** (2 * order - 1)
    score, noise, lag = evidence(*folded, ratios, order, None if known is None else known / fellows)
    ratio, variance, nats = _peak(ratios, score, noise)
    if (lag[score.argmax(axis=0), np.arange(len(series))] > GATE).any():
        ratio = _followed_by(folded, ratio, variance, order)
    return variance * fellows, variance * ratio, nats


def _followed_by(folded: tuple[Array, Array, Array], ratio: Array, variance: Array, order: int) -> Array:
    """Ratios (M,), doubled until a filter of noise variance (M,) keeps up with all motion."""
    raised = ratio * 2.0 ** np.arange(24)[:, None]
    _, noise, lag = evidence(*folded, raised, order)
    off = lag * np.sqrt(noise / variance)
    keeps: Array = np.asarray(off <= GATE)
    return np.asarray(raised[np.where(keeps.any(axis=0), keeps.argmax(axis=0), len(raised) - 1), np.arange(len(ratio))])


def _peak(ratios: Array, score: Array, noise: Array) -> tuple[Array, Array, Array]:
    """Ratios, noise and score (M,) at the greatest score (R,M), by parabolas through the best three."""
    at, each = np.clip(score.argmax(axis=0), 1, len(ratios) - 2), np.arange(ratios.shape[1])
    before, best, after = (np.stack([np.log(ratios), score, np.log(noise)])[:, at + side, each] for side in (-1, 0, 1))
    slope, bend = 0.5 * (after - before), before - 2.0 * best + after
    shift = np.clip(-slope[1] / np.minimum(bend[1], -np.finfo(float).tiny), -1.0, 1.0)
    ratio, peak, variance = best + shift * slope + 0.5 * shift**2 * bend
    return np.exp(ratio), np.exp(variance), peak


def _fellows(t: Array) -> int:
    """Readings per average."""
    step = median_step(t) if len(t) > 1 else SPACING
    return max(1, min(round(SPACING / max(step, 1e-9)), len(t) // FEWEST))


def _averages(series: list[tuple[Array, Array]]) -> tuple[tuple[Array, Array, Array], Array, Array]:
    """Averages of each joint's readings, side by side; readings (M,) per average, and the time (M,) s between them."""
    fellows = np.array([_fellows(t) for t, _ in series])
    means = [_averaged(t, y, k) for (t, y), k in zip(series, fellows, strict=True)]
    return _side_by_side(means), fellows, np.array([median_step(t) for t, *_ in means])


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
    """Time steps, readings (NaN after the last) and restarts, folded: (L,M,C) each; stretches follow the one before."""
    most = max(len(t) for t, *_ in series)
    length = STRETCH * max(2, -(-most // STRETCH))

    def folded(columns: Sequence[Array], after: float) -> Array:
        padded = [np.pad(column, (0, length - len(column)), constant_values=after) for column in columns]
        pairs = sliding_window_view(np.stack(padded, axis=1), 2 * STRETCH, axis=0)[::STRETCH]
        return np.ascontiguousarray(pairs.transpose(2, 1, 0))

    times, readings, breaks = zip(*series, strict=True)
    steps = [np.diff(t, prepend=t[0]) for t in times]
    return folded(steps, 0.0), folded(readings, np.nan), folded(breaks, False)


def _breaks(t: Array, y: Array) -> Array:
    """Readings (N,) that cannot follow from their neighbours, where the filter restarts."""
    steps, fresh = np.diff(y), np.zeros(len(y), bool)
    alone = _alone(np.abs(np.diff(steps)))
    at = np.flatnonzero(alone)
    alone[at] = ~_lasting(steps, at)
    fresh[1:-1] = alone
    fresh[2:] |= alone
    fresh[1:] |= np.diff(t) > LONG * median_step(t)
    return fresh


def _alone(bend: Array) -> Array:
    """Second differences (N,) that stand out of all others and of their neighbours; those of a starting arm do not."""
    moved = bend[bend > 0.0]
    # where most readings repeat, the others are typical
    typical = median(bend) if 2 * len(moved) > len(bend) else median(moved) if len(moved) else np.inf
    found = bend > BREAK * 1.4826 * typical
    at = np.flatnonzero(found)
    around = np.pad(bend, AROUND)[at[:, None] + np.arange(2 * AROUND + 1)]
    found[at] = bend[at] > BREAK * np.median(around, axis=1)
    return np.asarray(found)


def _lasting(steps: Array, at: Array) -> Array:
    """Whether motion (K,) starts or stops at second differences `at` (K,) of `steps` (N,): its steps last.

    The larger step beside it has a neighbour in its direction of at least a quarter, as innovations that lag have.
    After a false reading the next step leads back; a shift is one step.
    """
    around = np.pad(steps, AROUND, constant_values=np.nan)[at[:, None] + np.arange(1, 2 * AROUND + 1)]
    # as many steps before as after: where one speed follows another, the median is between them
    off = (around - np.nanmedian(around, axis=1, keepdims=True))[:, AROUND - 2 : AROUND + 2]
    second = np.abs(off[:, 2]) > np.abs(off[:, 1])
    large = np.where(second, off[:, 2], off[:, 1])
    beside = np.where(second[:, None], off[:, [1, 3]], off[:, [0, 2]])
    return np.asarray((4.0 * np.sign(large)[:, None] * beside >= np.abs(large)[:, None]).any(axis=1))

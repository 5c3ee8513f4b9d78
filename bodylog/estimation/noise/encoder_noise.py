"""Encoder noise and process noise of each joint, for white
acceleration or jerk, by the evidence of its readings.

Evidence of one joint's encoder readings alone, for many ratios of process to noise (kernels.py).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import wrightomega

from ...types import Array
from ..inference.filter_pass import GATE_SIGMA
from ..inference.kernel_call import bind_kernel_call
from ..measurements.long_arrays import LEVEL_READINGS, index_true_rows, measure_median_step
from ..measurements.records import Encoders
from ..measurements.timeline import GAP_STEPS, MAX_OUTPUT_RATE_HZ
from .quantisation import SAME_READING, compute_rest_factor, dither_readings

SKIPPED_READINGS = 10
"""Readings that do not count at the start, as a vague start costs white jerk more, nor
after a restart, which may be at a false reading; of fewer than 30, a third do not count
at the start. A joint with no more readings than this keeps its given noise. With 3,
errors among false readings are 13 to 27 % larger."""

BURST_S = 0.25
"""s: reaches last longer, and slower ones are no bursts."""


def compute_encoder_evidence(
    t: Array,
    y: Array,
    fresh: Array,
    ratios: Array,
    usual: float,
    order: int = 2,
    known: float | None = None,
) -> tuple[Array, Array, Array]:
    """Log evidence (R,) per ratio (R,) of process to noise,
    with the likeliest noise variance or a `known` one.

    Times t (N,) s of readings y (N,) rad, and where the filter restarts, `fresh` (N,) bool. The
    `usual` noise variance (rad²) tells as much as one reading does, of which the logarithm has the
    variance 2. Also the largest innovation (R,) of which the next one reaches a quarter, on the
    same side, in standard deviations: a false reading pulls the filter, so that the next is off to
    the other side; after a sudden motion it is off to the same side, by less.
    """
    dt = np.diff(t, prepend=t[0])
    count = np.arange(len(t))
    begin = min(len(t) // 3, SKIPPED_READINGS)
    counts = (
        count - np.maximum.accumulate(np.where(fresh, count, begin - SKIPPED_READINGS))
        >= SKIPPED_READINGS
    )
    fresh = np.asarray(fresh | (count == 0))
    # over a reading's variance: a restart knows nothing, and half of the digits are left
    vague = np.finfo(float).eps ** -0.5
    squares, logs, lag = np.empty((3, len(ratios)))
    bind_kernel_call(
        "weigh_noise_ratios",
        order=order,
        vague=vague,
        usual=float(np.median(dt[dt > 0.0])),
        dt=dt,
        y=np.ascontiguousarray(y),
        ratio=np.ascontiguousarray(ratios),
        fresh=fresh,
        counts=counts,
        squares=squares,
        logs=logs,
        lag=lag,
    )()
    n = counts.sum()
    prior = np.log(usual)
    squares = np.maximum(squares, np.finfo(float).tiny)
    # the logarithm u of greatest −½ (n u + squares e^(−u) + ½ (u − prior)²)
    most_probable = prior - n + wrightomega(np.log(squares) + n - prior)
    log = most_probable if known is None else np.full(len(ratios), np.log(known))
    # a noise of 1 µrad, a twentieth of the step of a
    # 19-bit encoder, keeps that of exact readings finite
    log = np.maximum(log, np.log(1e-12))
    score = -0.5 * (n * log + squares * np.exp(-log) + logs + 0.5 * (log - prior) ** 2)
    return np.where(np.isfinite(score), score, -np.inf), np.exp(log), lag * np.exp(-0.5 * log)


MAX_INSTANTS = 4000
"""Most averages, or averages and images, used from the
middle of the log: these tell a variance to √(2/N), 2 %.
"""
TRIED_MEMORIES = 2.0 ** np.linspace(7.7, -4.7, 48)
"""Averages: memories tried; a parabola through the best three is exact to .05 in the logarithm of
the density. With 64 as the longest, of 180 joints at rest for 12 to 60 s 39 % got a process density
above the `compute_least_process`; with 128, 4 %; logs of motion have the same errors with both."""
MAX_MEMORY_S = 1.0
"""s: longest memory of a filter for a joint at rest."""

Averages = tuple[Array, Array, Array]
"""Times (N,) s and values (N,) rad of means of readings, and where filters restart (N,) bool."""


@dataclass(frozen=True, eq=False)
class LearnedEncoderNoise:
    """Noise of encoders and of motion of one order.

    encoder (M,) rad²: of readings · dithered (M,) rad²: of these with a dither over their step ·
    process (M,) rad²/s³ or rad²/s⁵ · evidence (nats) of all joints.
    """

    encoder: Array
    dithered: Array
    process: Array
    evidence: float


class AveragedReadings(NamedTuple):
    """A joint's readings, dithered, as `Averages` of
    `each` of them; None if they are too few or constant.

    added, least: variances (rad²) of the dither and, at least, of a reading · repeated: factor on
    the variance of readings without averages.
    """

    averages: Averages | None
    each: int = 1
    added: float = 0.0
    least: float = 0.0
    repeated: float = 1.0


def average_joint_readings(encoders: Encoders) -> list[AveragedReadings]:
    """The readings of each joint in the middle of the log."""
    return [
        _average_one_joint(encoders.t[known], column[known], read[known])
        for column, read in zip(encoders.values.T, encoders.as_read.values.T, strict=True)
        for known in [index_true_rows(np.isfinite(column))]
    ]


def _average_one_joint(t: Array, y: Array, as_read: Array) -> AveragedReadings:
    """The averages of one joint's readings (N,) rad at t (N,) s, in the middle of the log.

    as_read (N,) rad: these before changes were taken out of them, in whole counts.
    """
    most = MAX_INSTANTS * count_readings_per_average(t)
    begin = max(0, (len(t) - most) // 2)
    t = t[begin : begin + most]
    y = y[begin : begin + most]
    as_read = as_read[begin : begin + most]
    if len(t) // count_readings_per_average(t) <= SKIPPED_READINGS or np.ptp(y) == 0.0:
        return AveragedReadings(None, repeated=compute_rest_factor(t) if len(t) else 1.0)
    spread, added, least = dither_readings(t, as_read)
    return AveragedReadings(*_average_between_breaks(t, spread + (y - as_read)), added, least)


def learn_encoder_noise(
    joints: list[AveragedReadings],
    encoder: Array,
    process: Array,
    order: int = 2,
    known: Array | None = None,
) -> LearnedEncoderNoise:
    """Learn encoder variances and process densities by
    evidence, the given variance counting as one reading.

    A joint that reads nothing, or always the same, keeps the given ones. Quantised readings are
    dithered over their step, whose variance is the least. known (M,) rad²: variances of the
    dithered readings, for which only process densities are learned.
    """
    encoder = encoder.copy()
    dithered = encoder.copy()
    process = process.copy()
    nats = 0.0
    for joint, one in enumerate(joints):
        if one.averages is None:
            encoder[joint] *= one.repeated
            continue
        usual = encoder[joint] + one.added
        given = None if known is None else known[joint] / one.each
        dithered[joint], process[joint], own = find_likeliest_noise(
            one.averages, one.each, usual, order, given
        )
        encoder[joint] = max(dithered[joint] - one.added, one.least)
        nats += own
    return LearnedEncoderNoise(encoder, dithered, process, nats)


def find_followable_process(
    encoders: Encoders, encoder: Array, process: Array, order: int
) -> Array:
    """Densities (M,), at least `process`, with which a
    filter of an order follows all readings of the encoders.

    Joints with few readings keep theirs.
    """
    process = process.copy()
    for joint, column in enumerate(encoders.values.T):
        known = np.isfinite(column)
        if known.sum() // count_readings_per_average(encoders.t[known]) > SKIPPED_READINGS:
            averages, each = _average_between_breaks(encoders.t[known], column[known])
            noise = encoder[joint]
            process[joint] = noise * _raise_until_followed(
                averages, process[joint] / noise, noise / each, order
            )
    return process


def compute_least_process(t: Array, encoder: Array, order: int) -> Array:
    """Least density (M,), which bounds a filter's memory, (R
    Δt / q)^(1/2p), by MAX_MEMORY_S; p is the motion's order.
    """
    step = measure_median_step(t) if len(t) > 1 else 0.0
    return np.asarray(encoder * step / MAX_MEMORY_S ** (2 * order))


def measure_burst_factors(encoders: Encoders, order: int) -> Array:
    """Power (M,) of a joint's motion where it is strong over its mean power, at least 1.

    By the differences d of an order between medians of BURST_S: E d⁴ / 3 (E d²)², which is the
    power that a motion has on average over its energy, and 1 where motion is Gaussian.
    """
    factors = np.ones(encoders.values.shape[1])
    for joint, column in enumerate(encoders.values.T):
        known = np.isfinite(column)
        power = np.square(_difference_medians(encoders.t[known], column[known], order))
        if power.any():
            factors[joint] = max(1.0, np.square(power).mean() / (3.0 * power.mean() ** 2))
    return factors


def _difference_medians(t: Array, y: Array, order: int) -> Array:
    """Differences of an order between medians of readings y (N,) at t (N,) s, BURST_S apart."""
    part = np.floor_divide(t, BURST_S)
    parts, begins, counts = np.unique(part, return_index=True, return_counts=True)
    medians = y[np.lexsort((y, part))][begins + counts // 2]
    adjacent = parts[order:] - parts[:-order] == order
    return np.asarray(np.diff(medians, order)[adjacent])


def find_likeliest_noise(
    averages: Averages, each: int, usual: float, order: int = 2, known: float | None = None
) -> tuple[float, float, float]:
    """Noise variance and density of most evidence of means of `each` readings; that evidence.

    usual: noise variance of a reading before any is known · known: that of a mean.
    """
    # a ratio of 1 per average has a memory of one average
    ratios = TRIED_MEMORIES ** (-2 * order) / measure_median_step(averages[0]) ** (2 * order - 1)
    score, noise, lag = compute_encoder_evidence(*averages, ratios, usual / each, order, known)
    ratio, variance, nats = _fit_evidence_peak(ratios, score, noise)
    if lag[score.argmax()] > GATE_SIGMA:
        ratio = _raise_until_followed(averages, ratio, variance, order)
    return variance * each, variance * ratio, nats


def _raise_until_followed(averages: Averages, ratio: float, variance: float, order: int) -> float:
    """The ratio, doubled until a filter of a noise variance keeps up with all motion."""
    raised = ratio * 2.0 ** np.arange(24)
    keeps = compute_encoder_evidence(*averages, raised, variance, order, variance)[2] <= GATE_SIGMA
    return float(raised[keeps.argmax() if keeps.any() else -1])


def _fit_evidence_peak(ratios: Array, score: Array, noise: Array) -> tuple[float, float, float]:
    """Ratio, noise and score at the greatest score (R,), by parabolas through the best three."""
    at = int(np.clip(score.argmax(), 1, len(ratios) - 2))
    before, best, after = np.stack([np.log(ratios), score, np.log(noise)], axis=1)[at - 1 : at + 2]
    slope = 0.5 * (after - before)
    bend = before - 2.0 * best + after
    shift = np.clip(-slope[1] / min(bend[1], -np.finfo(float).tiny), -1.0, 1.0)
    ratio, peak, variance = best + shift * slope + 0.5 * shift**2 * bend
    return float(np.exp(ratio)), float(np.exp(variance)), float(peak)


def count_readings_per_average(t: Array) -> int:
    """Readings at t (N,) s within one step of the fastest output."""
    if len(t) < 2:
        return 1
    return max(1, round(1.0 / MAX_OUTPUT_RATE_HZ / max(measure_median_step(t), 1e-9)))


def average_close_readings(found: Encoders) -> Encoders:
    """Means of close readings, among rows of the same encoders: these are read together."""
    known = np.isfinite(found.values)
    which = np.zeros(len(found.t), int)
    for column in known.T[~known.all(axis=0)]:
        which = np.unique(2 * which + column, return_inverse=True)[1]
    parts = np.split(np.argsort(which, kind="stable"), np.cumsum(np.bincount(which))[:-1])
    return _merge_encoders([_average_rows(found, part) for part in parts])


def _average_rows(found: Encoders, part: Array) -> Encoders:
    """Means of close rows among `part` (P,), which are of the same encoders."""
    each = count_readings_per_average(found.t[part])
    joints = found.values.shape[1]
    part = part[: len(part) // each * each]
    weights = (1.0 / found.relative_variance[part]).reshape(-1, each, joints)
    values = found.values[part].reshape(-1, each, joints)
    total = weights.sum(axis=1)
    t = found.t[part].reshape(-1, each).mean(axis=1)
    return Encoders(
        t,
        (weights * values).sum(axis=1) / total,
        found.source_ns[part[each - 1 :: each]],
        1.0 / total,
    )


def _merge_encoders(parts: list[Encoders]) -> Encoders:
    """One record of readings of different encoders, in
    time order; a row holds all readings of one time.
    """
    t = np.unique(np.concatenate([part.t for part in parts]))
    joints = parts[0].values.shape[1]
    values = np.full((len(t), joints), np.nan)
    relative = np.ones((len(t), joints))
    source = np.zeros(len(t), np.int64)
    for part in parts:
        at = np.searchsorted(t, part.t)
        read = np.isfinite(part.values[0])
        values[np.ix_(at, read)] = part.values[:, read]
        source[at] = part.source_ns
        relative[np.ix_(at, read)] = part.relative_variance[:, read]
    return Encoders(t, values, source, relative)


def _average_between_breaks(t: Array, y: Array) -> tuple[Averages, int]:
    """Means (N,) of times and of readings, where the filter
    restarts, at and after a mean with a break; how many each.

    Readings are averaged as far as a short stretch shows no acceleration.
    """
    each = count_readings_per_average(t)
    whole = len(t) // each * each
    broken = _find_breaks(t, y)
    t = t[:whole].reshape(-1, each).mean(axis=1)
    y = y[:whole].reshape(-1, each).mean(axis=1)
    if each > 1:
        broken = np.asarray(broken[:whole].reshape(-1, each).any(axis=1))
        broken[1:] |= broken[:-1]
        broken |= _find_breaks(t, y)
    return (t, y, broken), each


def _find_breaks(t: Array, y: Array) -> Array:
    """Readings (N,) that cannot follow from their neighbours, where the filter restarts."""
    steps = np.diff(y)
    fresh = np.zeros(len(y), bool)
    at = np.flatnonzero(_find_far_bends(np.abs(np.diff(steps))))
    at = at[~_find_lasting_motion(steps, at)]
    fresh[at + 1] = True
    fresh[at + 2] = True
    fresh[1:] |= np.diff(t) > GAP_STEPS * measure_median_step(t)
    return fresh


def _find_far_bends(bend: Array) -> Array:
    """Which second differences (N,) are beyond the gate, in robust standard deviations of all.

    With 10 in place of 5, and only those that stand out of their
    neighbours, errors where 2 % of the readings are false are a third
    larger, and error bars too large; on sound logs nothing changes.
    """
    moved = bend[bend > SAME_READING]
    # where most readings repeat, the others are typical
    typical = np.inf
    if 2 * len(moved) > len(bend):
        typical = np.median(bend)
    elif len(moved):
        typical = np.median(moved)
    return np.asarray(bend > GATE_SIGMA * 1.4826 * typical)


def _find_lasting_motion(steps: Array, at: Array) -> Array:
    """Whether motion (K,) starts or stops at second
    differences `at` (K,) of `steps` (N,): its steps last.

    The larger step beside it has a neighbour in its direction of at least a quarter, as innovations
    that lag have. After a false reading the next step leads back; a shift is one step.
    """
    padded = np.pad(steps, LEVEL_READINGS, constant_values=np.nan)
    around = padded[at[:, None] + np.arange(1, 2 * LEVEL_READINGS + 1)]
    # as many steps before as after: where one speed follows another, the median is between them
    off = around - np.nanmedian(around, axis=1, keepdims=True)
    off = off[:, LEVEL_READINGS - 2 : LEVEL_READINGS + 2]
    second = np.abs(off[:, 2]) > np.abs(off[:, 1])
    large = np.where(second, off[:, 2], off[:, 1])
    beside = np.where(second[:, None], off[:, [1, 3]], off[:, [0, 2]])
    follows = 4.0 * np.sign(large)[:, None] * beside >= np.abs(large)[:, None]
    return np.asarray(follows.any(axis=1))

"""Readings between two knots as one factor on the states
at both: exact, for all intervals and joints at once.

Given the state x at the first knot, the state after some of the readings is normal: mean A x + a,
covariance P. Each reading y = h·state + n of variance v has the innovation y − h·(A x + a) of
variance s = h P h + v, so it adds A'h h'A / s to the information on x, and a Kalman gain updates A,
a and P. Several right-hand sides are carried at once: the first is what was read, the others are
what the columns of the border change in it.
"""

from dataclasses import dataclass, field
from math import tau

import numpy as np

from ...motion import motion_covariance
from ...types import Array
from .encoder_error import MOTION_ORDER, JointNoise

SAME_TIME_S = 1e-9
"""s: times that differ by less are one, up to the rounding of their stamps."""


@dataclass(frozen=True, eq=False)
class Readings:
    """Encoder readings about K knots at t (K,) s, as S steps in each of K−1 intervals.

    at_knot (K,M,R) rad and its weight (K,M) · between (S,K-1,M,R) rad, weight
    (S,K-1,M): 0 for no reading · gaps (S+1,K-1) s: from the knot or reading before · unit_motion
    (3,3,S+1,K-1): covariance that angle and its derivatives gain over them for a process of
    variance 1. A weight is the inverse of a variance relative to the encoder's; believed (…): share
    of a reading that is not taken for an outlier.
    """

    t: Array
    at_knot: Array
    knot_weight: Array
    between: Array
    between_weight: Array
    gaps: Array
    unit_motion: Array
    knot_believed: Array
    between_believed: Array


@dataclass(frozen=True, eq=False)
class PairFactors:
    """Factors ½ z'Gz − z'u c + ½ c'W c + logs on neighbouring
    states z = (x₀, x₁) of each joint, c = (1, −g).

    info (2p,2p,I,M) · right (2p,R,I,M) · square (R,R,I,M) · logs (I,M): intervals and joints last,
    where NumPy is fast for small states.
    """

    info: Array
    right: Array
    square: Array
    logs: Array


@dataclass(frozen=True, eq=False)
class PassedReading:
    """Readings of one step, as condensing passes them: the innovation (p+R,I,M) of each by the
    state x₀ at the knot before and by c, its inverse variance (I,M), 0 for no reading, the gain
    (p,I,M), and the variance (I,M) of the reading's noise.
    """

    innovation: Array
    inverse: Array
    gain: Array
    var: Array


@dataclass(frozen=True, eq=False)
class PassedSteps:
    """What condensing passes, in order: readings, and the last state before each gap, as
    x₀ and c tell it (p+R,I,M), with its covariance (p,I,M) with all states.
    """

    readings: list[PassedReading] = field(default_factory=list)
    lasts: list[tuple[Array, Array]] = field(default_factory=list)


def place_readings(
    t: Array, values: Array, relative: Array, believed: Array, knots: Array
) -> Readings:
    """Distribute readings at t (N,) s over the knots (K,) s; those within SAME_TIME_S of one are
    at it.

    values (N,M,R) rad, NaN in the first right-hand side where missing · relative (N,M): variance
    over the encoder's · believed (N,M).
    """
    known = np.isfinite(values[..., 0])
    weight = np.where(known, believed / relative, 0.0)
    believed = np.where(known, believed, 0.0)
    values = np.where(known[..., None], values, 0.0)
    count = len(knots)
    after = np.searchsorted(knots, t - SAME_TIME_S)
    is_at = (after < count) & (np.abs(knots[np.minimum(after, count - 1)] - t) <= SAME_TIME_S)
    rows = np.flatnonzero(~is_at & (after > 0) & (after < count))
    interval = after[rows] - 1
    first = np.searchsorted(interval, interval)
    step = np.arange(len(rows)) - first
    steps = int(step.max(initial=-1)) + 1
    stamps = np.full((steps + 2, count - 1), np.nan)
    stamps[0] = knots[:-1]
    stamps[step + 1, interval] = t[rows]
    stamps[-1] = knots[1:]
    stamps = np.fmax.accumulate(stamps, axis=0)

    def place_rows(part: Array) -> tuple[Array, Array]:
        """What is at a knot, and what is between two."""
        at_knot = np.zeros((count, *part.shape[1:]))
        between = np.zeros((steps, count - 1, *part.shape[1:]))
        at_knot[after[is_at]] = part[is_at]
        between[step, interval] = part[rows]
        return at_knot, between

    at_knot, between = place_rows(values)
    knot_weight, between_weight = place_rows(weight)
    knot_believed, between_believed = place_rows(believed)
    gaps = np.diff(stamps, axis=0)
    motion = motion_covariance(MOTION_ORDER, gaps.ravel())
    motion = motion.reshape(*gaps.shape, MOTION_ORDER, MOTION_ORDER)
    return Readings(
        knots,
        at_knot,
        knot_weight,
        between,
        between_weight,
        gaps,
        np.ascontiguousarray(np.moveaxis(motion, (-2, -1), (0, 1))),
        knot_believed,
        between_believed,
    )


def condense_readings(
    readings: Readings, noise: JointNoise, passed: PassedSteps | None = None
) -> PairFactors:
    """The factor of each interval and joint on the states at both its ends; `passed`, if given,
    gets what is passed.
    """
    steps, count, m, r = readings.between.shape
    p = noise.state_count
    decays = np.exp(-readings.gaps[..., None] / noise.seconds)
    gains = noise.compute_gained_covariance(readings.gaps, readings.unit_motion)
    values = np.ascontiguousarray(np.moveaxis(readings.between, -1, 1))
    known = readings.between_weight > 0.0
    var = noise.white / np.where(known, readings.between_weight, 1.0)
    logs = compute_normalisation(var, readings.between_believed).sum(axis=0)
    carry = np.zeros((p, p, count, m))
    carry[np.arange(p), np.arange(p)] = 1.0
    shift = np.zeros((p, r, count, m))
    cov = np.zeros((p, p, count, m))
    info = np.zeros((p, p, count, m))
    right = np.zeros((p, r, count, m))
    square = np.zeros((r, r, count, m))
    for k in range(steps + 1):
        if passed is not None:
            passed.lasts.append((np.concatenate([carry[-1], shift[-1]]), cov[:, -1].copy()))
        for states in (carry, shift, cov, cov.swapaxes(0, 1)):
            noise.advance_states(states, readings.gaps[k][:, None], decays[k])
        cov += gains[:, :, k]
        if k == steps:
            break
        seen = noise.read_encoders(carry)
        spread = noise.read_encoders(cov)
        total = noise.read_encoders(spread) + var[k]
        inverse = np.where(known[k], 1.0 / total, 0.0)
        innovation = values[k] - noise.read_encoders(shift)
        weighed = inverse * seen
        info += weighed[:, None] * seen
        right += weighed[:, None] * innovation
        _add_square(square, inverse * innovation, innovation)
        logs += np.where(known[k], 0.5 * np.log(total / var[k]), 0.0)
        gain = inverse * spread
        if passed is not None:
            by_start = np.concatenate([-seen, innovation])
            passed.readings.append(PassedReading(by_start, inverse, gain, var[k]))
        carry -= gain[:, None] * seen
        shift += gain[:, None] * innovation
        cov -= gain[:, None] * spread
    return _join_second_states(carry, shift, cov, PairFactors(info, right, square, logs))


def _add_square(square: Array, left: Array, right: Array) -> None:
    """Add the product of left (R,I,M) and right (R,I,M), which is
    symmetric, to the upper triangle of square (R,R,I,M).
    """
    for i, row in enumerate(left):
        square[i, i:] += row * right[i:]


def compute_normalisation(var: Array, believed: Array) -> Array:
    """½ ln 2πR of each reading as far as it is believed; its variance is var = R / believed."""
    return np.asarray(0.5 * believed * np.log(tau * var * np.where(believed > 0.0, believed, 1.0)))


def _join_second_states(carry: Array, shift: Array, cov: Array, start: PairFactors) -> PairFactors:
    """Join what is known of the first state with the second one's normal distribution given it.
    Of the square at the start, the upper triangle.
    """
    p, r = shift.shape[:2]
    inverse, log_determinant = _invert_posdef(cov)
    pulled = np.zeros(carry.shape)
    pushed = np.zeros(shift.shape)
    for row, column, moved in zip(inverse, carry, shift, strict=True):
        pulled += column[:, None] * row
        pushed += row[:, None] * moved
    info = np.empty((2 * p, 2 * p, *cov.shape[2:]))
    right = np.empty((2 * p, r, *cov.shape[2:]))
    info[:p, :p] = start.info
    right[:p] = start.right
    square = start.square
    for column, known, moved, leant in zip(
        pulled.swapaxes(0, 1), carry, shift, pushed, strict=True
    ):
        info[:p, :p] += column[:, None] * known
        right[:p] -= column[:, None] * moved
        _add_square(square, leant, moved)
    info[:p, p:] = -pulled
    info[p:, :p] = -pulled.swapaxes(0, 1)
    info[p:, p:] = inverse
    right[p:] = pushed
    for i in range(1, r):
        square[i, :i] = square[:i, i]
    return PairFactors(info, right, square, start.logs + 0.5 * log_determinant)


def _invert_posdef(matrices: Array) -> tuple[Array, Array]:
    """Inverses (p,p,…) and ln determinants (…) of positive definite matrices (p,p,…), by
    elimination without pivoting, whose rounding does not depend on the states' units.

    Of one that rounding leaves indefinite, ln |determinant|: the whole log's elimination refuses
    it. LinAlgError if one is singular.
    """
    inverse = matrices.copy()
    log_determinant = np.zeros(matrices.shape[2:])
    for k in range(len(matrices)):
        pivot = inverse[k, k].copy()
        if (pivot == 0.0).any():
            raise np.linalg.LinAlgError("the motion between two knots is singular")
        log_determinant += np.log(np.abs(pivot))
        column = inverse[:, k] / pivot
        row = inverse[k].copy()
        inverse -= column[:, None] * row
        inverse[:, k] = -column
        inverse[k] = row / pivot
        inverse[k, k] = 1.0 / pivot
    return 0.5 * (inverse + inverse.swapaxes(0, 1)), log_determinant

"""Readings between two knots as one factor on the states
at both: exact, for all intervals and joints at once.

Given the state x at the first knot, the state after some of the readings is normal: mean A x + a,
covariance P. Each reading y = h·state + n of variance v has the innovation y − h·(A x + a) of
variance s = h P h + v, so it adds A'h h'A / s to the information on x, and a Kalman gain updates A,
a and P. Several right-hand sides are carried at once: the first is what was read, the others are
what the columns of the border change in it.
"""

from dataclasses import dataclass

import numpy as np

from ...types import Array
from .encoder_error import JointNoise

LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class Readings:
    """Encoder readings about K knots at t (K,) s, as S steps in each of K−1 intervals.

    at_knot (K,M,R) rad and its weight (K,M) · between (S,K-1,M,R) rad, weight
    (S,K-1,M): 0 for no reading · gaps (S+1,K-1) s: from the knot or reading before. A
    weight is the inverse of a variance relative to the encoder's; believed (…): share
    of a reading that is not taken for an outlier.
    """

    t: Array
    at_knot: Array
    knot_weight: Array
    between: Array
    between_weight: Array
    gaps: Array
    knot_believed: Array
    between_believed: Array


@dataclass(frozen=True, eq=False)
class PairFactors:
    """Factors ½ z'Gz − z'u c + ½ c'W c + logs on neighbouring
    states z = (x₀, x₁) of each joint, c = (1, −g).

    info (I,M,2p,2p) · right (I,M,2p,R) · square (I,M,R,R) · logs (I,M).
    """

    info: Array
    right: Array
    square: Array
    logs: Array


def place_readings(
    t: Array, values: Array, relative: Array, believed: Array, knots: Array, near: float = 1e-9
) -> Readings:
    """Distribute readings at t (N,) s over the knots
    (K,) s; those within `near` s of one are at it.

    values (N,M,R) rad, NaN in the first right-hand side where missing · relative (N,M): variance
    over the encoder's · believed (N,M).
    """
    _, m, r = values.shape
    known = np.isfinite(values[..., 0])
    weight = np.where(known, believed / relative, 0.0)
    believed = np.where(known, believed, 0.0)
    values = np.where(known[..., None], values, 0.0)
    count = len(knots)
    after = np.searchsorted(knots, t - near)
    is_at = (after < count) & (np.abs(knots[np.minimum(after, count - 1)] - t) <= near)
    at_knot = np.zeros((count, m, r))
    knot_weight = np.zeros((count, m))
    knot_believed = np.zeros((count, m))
    at_knot[after[is_at]] = values[is_at]
    knot_weight[after[is_at]] = weight[is_at]
    knot_believed[after[is_at]] = believed[is_at]
    rows = np.flatnonzero(~is_at & (after > 0) & (after < count))
    interval = after[rows] - 1
    first = np.searchsorted(interval, interval)
    step = np.arange(len(rows)) - first
    steps = int(step.max(initial=-1)) + 1
    stamps = np.full((steps + 2, count - 1), np.nan)
    stamps[0] = knots[:-1]
    stamps[step + 1, interval] = t[rows]
    for k in range(1, steps + 2):
        stamps[k] = np.where(
            np.isnan(stamps[k]), knots[1:] if k > steps else stamps[k - 1], stamps[k]
        )
    between = np.zeros((steps, count - 1, m, r))
    between_weight = np.zeros((steps, count - 1, m))
    between_believed = np.zeros((steps, count - 1, m))
    between[step, interval] = values[rows]
    between_weight[step, interval] = weight[rows]
    between_believed[step, interval] = believed[rows]
    return Readings(
        knots,
        at_knot,
        knot_weight,
        between,
        between_weight,
        np.diff(stamps, axis=0),
        knot_believed,
        between_believed,
    )


def condense(readings: Readings, noise: JointNoise) -> PairFactors:
    """The factor of each interval and joint on the states at both its ends.

    Arrays have the states first and intervals and
    joints last, where NumPy is fast for small states.
    """
    steps, count, m, r = readings.between.shape
    p = noise.states
    decays = np.exp(-readings.gaps[..., None] / noise.seconds)
    gains = noise.covariance(readings.gaps)
    reads = noise.reads.T[:, None, :]
    values = np.ascontiguousarray(np.moveaxis(readings.between, -1, 1))
    known = readings.between_weight > 0.0
    var = noise.white / np.where(known, readings.between_weight, 1.0)
    logs = normalisation(var, readings.between_believed).sum(axis=0)
    carry = np.broadcast_to(np.eye(p)[:, :, None, None], (p, p, count, m))
    shift = np.zeros((p, r, count, m))
    cov = np.zeros((p, p, count, m))
    info = np.zeros((p, p, count, m))
    right = np.zeros((p, r, count, m))
    square = np.zeros((r, r, count, m))
    for k in range(steps + 1):
        ahead = (readings.gaps[k][:, None], decays[k])
        carry = noise.advance(carry, *ahead)
        shift = noise.advance(shift, *ahead)
        cov = noise.advance(noise.advance(cov, *ahead).swapaxes(0, 1), *ahead) + gains[:, :, k]
        if k == steps:
            break
        seen = (reads[:, None] * carry).sum(axis=0)
        spread = (cov * reads).sum(axis=1)
        total = (reads * spread).sum(axis=0) + var[k]
        inverse = np.where(known[k], 1.0 / total, 0.0)
        innovation = values[k] - (reads[:, None] * shift).sum(axis=0)
        weighed = inverse * seen
        info = info + weighed[:, None] * seen
        right = right + weighed[:, None] * innovation
        square = square + inverse * innovation[:, None] * innovation
        logs += np.where(known[k], 0.5 * np.log(total / var[k]), 0.0)
        gain = inverse * spread
        carry = carry - gain[:, None] * seen
        shift = shift + gain[:, None] * innovation
        cov = cov - gain[:, None] * spread
    parts = [np.moveaxis(part, (2, 3), (0, 1)) for part in (carry, shift, cov, info, right, square)]
    carry, shift, cov, info, right, square = parts
    return _pair_factors(carry, shift, cov, PairFactors(info, right, square, logs))


def normalisation(var: Array, believed: Array) -> Array:
    """½ ln 2πR of each reading as far as it is
    believed, where its variance is var = R / believed.
    """
    return np.asarray(
        0.5 * believed * (LOG_2PI + np.log(var * np.where(believed > 0.0, believed, 1.0)))
    )


def _pair_factors(carry: Array, shift: Array, cov: Array, start: PairFactors) -> PairFactors:
    """Join what is known of the first state with the second one's normal distribution given it."""
    scale = np.sqrt(np.einsum("impp->imp", cov))
    scaled = cov / (scale[..., None] * scale[..., None, :])
    inverse = np.linalg.inv(scaled) / (scale[..., None] * scale[..., None, :])
    inverse = 0.5 * (inverse + inverse.swapaxes(-1, -2))
    pulled = carry.swapaxes(-1, -2) @ inverse
    info = np.block([[start.info + pulled @ carry, -pulled], [-pulled.swapaxes(-1, -2), inverse]])
    right = np.concatenate([start.right - pulled @ shift, inverse @ shift], axis=-2)
    square = start.square + shift.swapaxes(-1, -2) @ inverse @ shift
    logs = start.logs + 0.5 * np.linalg.slogdet(scaled)[1] + np.log(scale).sum(axis=-1)
    return PairFactors(info, right, square, logs)

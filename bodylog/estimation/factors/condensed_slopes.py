"""How the expected cost of condensed readings changes with their noise, exactly.

By Fisher's identity a slope of −ln p is the expected slope of the cost of all states, those between
the knots included. A disturbance smoother (Koopman 1993) has these without the states: with r the
slope by the state after a gap, over which motion adds Q, and u that by a reading of variance v,

    d(−ln p) = −½ tr dQ (E r r' − N) − ½ dv (E u² − D),

where N and D are what later measurements say of r and u if the states at both knots are known.
Both are linear in s = (x₀, c), the first knot's state and the columns' sizes, so that one pass
backward over the readings carries M = E r r' − N and E r s'.
"""

from dataclasses import dataclass

import numpy as np

from ...types import Array
from .condensing import PairFactors, PassedReading, PassedSteps, Readings
from .encoder_error import MOTION_ORDER, JointNoise


@dataclass(frozen=True, eq=False)
class Expected:
    """Expectations by the posterior, as pair factors are laid out: of pairs z
    (2p,2p,K-1,M), of z c' (2p,R,K-1,M) and of c c' (R,R).
    """

    pairs: Array
    with_columns: Array
    columns: Array

    def with_start(self) -> tuple[Array, Array]:
        """E z s' (2p,p+R,K-1,M) and E c s' (R,p+R,K-1,M)."""
        p = len(self.pairs) // 2
        square = np.broadcast_to(
            self.columns[..., None, None], (*self.columns.shape, *self.pairs.shape[2:])
        )
        states = np.concatenate([self.pairs[:, :p], self.with_columns], axis=1)
        return states, np.concatenate([self.with_columns[:p].swapaxes(0, 1), square], axis=1)


def measure_condensed_slopes(
    readings: Readings,
    noise: JointNoise,
    pairs: PairFactors,
    passed: PassedSteps,
    expected: Expected,
) -> dict[str, Array]:
    """Slopes (M,) of the expected cost of the readings between knots, by the logarithms of
    `white` and `process`, and of `error` and `seconds` where errors last.

    pairs, passed: what the readings are condensed to, and what that passes.
    """
    p = noise.state_count
    states, columns = expected.with_start()
    starts = np.concatenate([states[:p], columns])
    # r after the last gap is (x₁ − what x₀ and c predict) in its precision
    ahead = pairs.info[p:]
    shift = pairs.right[p:]
    by_starts = _multiply_blocks(ahead, states) - _multiply_blocks(shift, columns)
    with_pair = _multiply_blocks(ahead, expected.pairs)
    with_pair -= _multiply_blocks(shift, expected.with_columns.swapaxes(0, 1))
    square = _multiply_blocks(with_pair, ahead.swapaxes(0, 1))
    square -= _multiply_blocks(by_starts[:, p:], shift.swapaxes(0, 1)) + ahead[:, p:]
    white = np.zeros(by_starts.shape[2:])
    process = white.copy()
    error = white.copy()
    seconds = white.copy()
    for k in reversed(range(len(passed.lasts))):
        if k < len(passed.readings):
            white += _pass_reading(noise, passed.readings[k], starts, by_starts, square)
        by_start, last_cov = passed.lasts[k]
        gap = readings.gaps[k][:, None]
        decay = np.exp(-gap / noise.seconds)
        gained = readings.unit_motion[:, :, k, :, None] * square[:MOTION_ORDER, :MOTION_ORDER]
        process -= 0.5 * noise.process * gained.sum(axis=(0, 1))
        last = square[-1, -1].copy()
        kept = (by_starts[-1] * by_start).sum(axis=0)
        noise.carry_slopes_back(by_starts, gap, decay)
        noise.carry_slopes_back(square, gap, decay)
        if noise.error is not None:
            kept += (square[:, -1] * last_cov).sum(axis=0)
            var = noise.error_variance
            faster = gap / noise.seconds * decay
            error += var * np.expm1(-2.0 * gap / noise.seconds) * last
            seconds += faster * (var * decay * last - kept)
        noise.carry_slopes_back(square.swapaxes(0, 1), gap, decay)
    known = readings.between_weight > 0.0
    shares = np.where(known, readings.between_believed - 1.0, 0.0).sum(axis=(0, 1))
    found = {"white": white.sum(axis=0) + 0.5 * shares, "process": process.sum(axis=0)}
    if noise.error is not None:
        found |= {"error": error.sum(axis=0), "seconds": seconds.sum(axis=0)}
    return found


def _pass_reading(
    noise: JointNoise, step: PassedReading, starts: Array, by_starts: Array, square: Array
) -> Array:
    """Slopes (K-1,M) by ln v of a reading; E r s' and M in place to what they are before it."""
    of_starts = (step.innovation[:, None] * starts).sum(axis=0)
    with_slope = (by_starts * step.innovation).sum(axis=1)
    mean_square = (of_starts * step.innovation).sum(axis=0)
    reach = (square * step.gain).sum(axis=1)
    inverse = step.inverse
    # u = innovation / variance − gain' r
    own = inverse * of_starts - (step.gain[:, None] * by_starts).sum(axis=0)
    pulled = ((reach - 2.0 * inverse * with_slope) * step.gain).sum(axis=0)
    excess = inverse * (inverse * mean_square - 1.0) + pulled
    shared = inverse * with_slope - reach
    noise.add_to_readings(shared, 0.5 * excess)
    noise.add_to_readings(by_starts, own)
    noise.add_to_readings(square, shared)
    noise.add_to_readings(square.swapaxes(0, 1), shared)
    return np.asarray(-0.5 * step.var * excess)


def _multiply_blocks(left: Array, right: Array) -> Array:
    """Products (a,c,I,M) of left (a,b,I,M) and right (b,c,I,M)."""
    found = np.zeros((len(left), *right.shape[1:]))
    for column, row in zip(left.swapaxes(0, 1), right, strict=True):
        found += column[:, None] * row
    return found

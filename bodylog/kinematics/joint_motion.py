"""Joint angles as curves of time: smoothed samples with cubic pieces between them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..types import Array


@dataclass(frozen=True, eq=False)
class JointCurve:
    """Joint angles q (K,M), rad or m, at times t (K,) s, ascending; slopes (K,M) per s.

    error: what the angles are off by, from noise of the encoders; None where that is not known.
    """

    t: Array
    q: Array
    slopes: Array
    error: "CurveError | None" = None

    @cached_property
    def _pieces(self) -> Array:
        """Coefficients (K−1,4,M) of each piece by powers of the share of its duration."""
        gap = np.diff(self.t)[:, None]
        step = np.diff(self.q, axis=0)
        slope = self.slopes[:-1] * gap
        next_slope = self.slopes[1:] * gap
        square = 3.0 * step - 2.0 * slope - next_slope
        cube = slope + next_slope - 2.0 * step
        return np.stack([self.q[:-1], slope, square, cube], axis=1)

    def at(self, t: Array) -> tuple[Array, Array]:
        """Angles (N,M) and speeds (N,M) at times t (N,) s,
        by cubic Hermite pieces; at rest beyond both ends.
        """
        row = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2)
        gap = self.t[row + 1] - self.t[row]
        share = np.clip((t - self.t[row]) / gap, 0.0, 1.0)[:, None]
        begin, slope, square, cube = self._pieces[row].transpose(1, 0, 2)
        angle = begin + share * (slope + share * (square + share * cube))
        inside = ((t >= self.t[0]) & (t <= self.t[-1]))[:, None] / gap[:, None]
        return angle, (slope + share * (2.0 * square + share * (3.0 * cube))) * inside


@dataclass(frozen=True, eq=False)
class CurveError:
    """The error of smoothed joint angles, a stationary process for each joint: std (M,), rad or m,
    and rate (M,) 1/s, the frequency above which smoothing takes the noise out.

    A motion whose third derivative is white with density q (rad²/s⁵), read every Δ s with variance
    σ², leaves the error spectrum σ²Δ / (1 + (ω/ω₀)⁶), ω₀⁶ = q/(σ²Δ) (Wiener).
    """

    std: Array
    rate: Array

    def correlation(self, joint: int, lag: Array) -> Array:
        """Correlation of a joint's error over lags (…) s: its spectrum's transform."""
        z = self.rate[joint] * np.abs(lag)
        turn = np.sqrt(0.75) * z
        ring = np.exp(-0.5 * z) * (np.cos(turn) + np.sqrt(3.0) * np.sin(turn))
        return np.asarray(0.5 * (np.exp(-z) + ring))


def curve_error(noise: Array, process: Array, every_s: Array) -> CurveError:
    """The error for variances of noise (M,), densities of the
    process (M,) rad²/s⁵, and steps between readings (M,) s.
    """
    density = noise * every_s
    rate = (process / density) ** (1.0 / 6.0)
    return CurveError(np.sqrt(density * rate / 3.0), rate)


def curve_through_samples(t: Array, q: Array, error: CurveError | None = None) -> JointCurve:
    """The curve through samples q (K,M) at t (K,) s,
    K at least 2, with slopes by central differences.
    """
    return JointCurve(t, q, np.gradient(q, t, axis=0), error)

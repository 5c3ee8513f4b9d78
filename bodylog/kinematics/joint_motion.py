"""Joint angles as curves of time: smoothed samples with cubic pieces between them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..types import Array


@dataclass(frozen=True, eq=False)
class JointCurve:
    """Joint angles q (K,M), rad or m, at times t (K,) s, ascending; slopes (K,M) per s."""

    t: Array
    q: Array
    slopes: Array

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


def curve_through_samples(t: Array, q: Array) -> JointCurve:
    """The curve through samples q (K,M) at t (K,) s,
    K at least 2, with slopes by central differences.
    """
    return JointCurve(t, q, np.gradient(q, t, axis=0))

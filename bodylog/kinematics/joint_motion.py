"""Joint angles as curves of time: smoothed samples with cubic pieces between them."""

from dataclasses import dataclass

import numpy as np

from ..types import Array


@dataclass(frozen=True, eq=False)
class JointCurve:
    """Joint angles q (K,M), rad or m, at times t (K,) s, ascending; slopes (K,M) per s."""

    t: Array
    q: Array
    slopes: Array

    def at(self, t: Array) -> tuple[Array, Array]:
        """Angles (N,M) and speeds (N,M) at times t (N,) s,
        by cubic Hermite pieces; at rest beyond both ends.
        """
        row = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2)
        gap = (self.t[row + 1] - self.t[row])[:, None]
        share = np.clip((t - self.t[row])[:, None] / gap, 0.0, 1.0)
        begin, end = self.q[row], self.q[row + 1]
        slope = self.slopes[row] * gap
        next_slope = self.slopes[row + 1] * gap
        # begin + slope s + (3 d − 2 slope − next_slope) s² + (slope + next_slope − 2 d) s³
        step = end - begin
        square = 3.0 * step - 2.0 * slope - next_slope
        cube = slope + next_slope - 2.0 * step
        angle = begin + share * (slope + share * (square + share * cube))
        speed = (slope + share * (2.0 * square + share * 3.0 * cube)) / gap
        outside = (t < self.t[0]) | (t > self.t[-1])
        return angle, np.where(outside[:, None], 0.0, speed)


def curve_through_samples(t: Array, q: Array) -> JointCurve:
    """The curve through samples q (K,M) at t (K,) s,
    K at least 2, with slopes by central differences.
    """
    return JointCurve(t, q, np.gradient(q, t, axis=0))

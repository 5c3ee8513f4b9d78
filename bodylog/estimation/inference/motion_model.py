"""Motion of the joints: the highest derivative of each angle is white noise; encoder offsets are random walks.

A joint's S states are angle, rate[, acceleration][, offset]. Arrays are (S, S, M, B): joints M, intervals B last.
"""

from dataclasses import dataclass
from math import factorial

import numpy as np

from ...types import Array


@dataclass(frozen=True, eq=False)
class MotionModel:
    """Order 2: white acceleration, process (M,) rad²/s³ · order 3: white jerk, rad²/s⁵ · walk (M,) rad²/s or None."""

    order: int
    process: Array
    walk: Array | None = None

    @property
    def joints(self) -> int:
        """Number M of joints."""
        return len(self.process)

    @property
    def states(self) -> int:
        """Number S of states of a joint."""
        return self.order + (self.walk is not None)

    def observe(self, a: Array) -> Array:
        """Predicted encoder reading from states a (S, …): the angle, plus the offset where there is one."""
        return np.asarray(a[0] if self.walk is None else a[0] + a[-1])

    def carry(self, a: Array, dt: Array) -> None:
        """Move states a (S, …, B) by dt (B,) s, in place."""
        for state in range(self.order - 1):
            power = dt
            for lag in range(1, self.order - state):
                a[state] += power * a[state + lag] if lag == 1 else (power / factorial(lag)) * a[state + lag]
                power = power * dt

    def spread(self, dt: Array) -> Array:
        """Covariance (S,S,M,B) of the process noise within dt (B,) s."""
        s, p = self.states, self.order
        noise = np.zeros((s, s, self.joints, len(dt)))
        scaled = self.process[:, None]
        for i in range(p):
            for j in range(p):
                power = 2 * p - 1 - i - j
                noise[i, j] = scaled * (dt**power / (power * factorial(p - 1 - i) * factorial(p - 1 - j)))
        if self.walk is not None:
            noise[-1, -1] = self.walk[:, None] * dt
        return noise

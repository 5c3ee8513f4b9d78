"""How a joint moves, and how its encoder errs: the prior of the state between two times.

A joint's state is angle, rate, acceleration, and an error e of its encoder that lasts: an
Ornstein–Uhlenbeck process

    de = −e/τ dt + √(2 σ²/τ) dw,    cov(e(t), e(t + Δ)) = σ² exp(−Δ/τ).

σ → 0 leaves white noise alone, τ → ∞ a constant offset. The error is at the encoder, which then
reads q + e, or at the link, which then stands at q + e while the encoder reads q.
"""

from dataclasses import dataclass, replace

import numpy as np

from ... import motion
from ...types import Array

MOTION_ORDER = 3
"""White jerk: white acceleration takes the noise of motors for motion."""
LEAST_STD = 1e-8
"""rad: standard deviation of an error that is absent, so that matrices keep their inverses."""


@dataclass(frozen=True, eq=False)
class JointNoise:
    """How M joints move and are read.

    white (M,) rad²: of a reading · process (M,) rad²/s⁵: of white jerk · error (M,) rad: standard
    deviation σ of what lasts; None for none · seconds (M,) s: its τ · at_link (M,) bool: whether
    it is at the link · learned (M,) bool: joints whose σ and τ, one for all, come from the log; the
    others' are given.
    """

    white: Array
    process: Array
    error: Array | None
    seconds: Array
    at_link: Array
    learned: Array

    @property
    def state_count(self) -> int:
        """Number p of a joint's states."""
        return MOTION_ORDER + (self.error is not None)

    @property
    def error_variance(self) -> Array:
        """Variance (M,) rad² of what lasts, at least LEAST_STD²."""
        assert self.error is not None
        return np.square(np.maximum(self.error, LEAST_STD))

    @property
    def start_precision(self) -> Array:
        """Precision (M,p,p) of the state at the first knot, about the first angles read."""
        var = np.tile(np.square(np.array(motion.START_STD[:MOTION_ORDER])), (len(self.white), 1))
        if self.error is not None:
            var = np.column_stack([var, self.error_variance])
        return np.asarray(np.eye(self.state_count) / var[:, None, :])

    def build_link_rows(self, ahead: Array) -> Array:
        """Where links stand, as rows (F,M,p) on each joint's state `ahead` (F,) s before."""
        rows = np.zeros((len(ahead), len(self.white), self.state_count))
        rows[..., :MOTION_ORDER] = motion.motion_transition(MOTION_ORDER, ahead)[:, None, 0, :]
        if self.error is not None:
            rows[..., MOTION_ORDER] = self.at_link
        return rows

    def build_reading_rows(self, ahead: Array) -> Array:
        """What encoders read, as rows (F,M,p) on each joint's state `ahead` (F,) s before."""
        return replace(self, at_link=~self.at_link).build_link_rows(ahead)

    def place_rows_on_knots(self, rows: Array, size: int) -> Array:
        """Rows (F,M,p) on each joint's state as rows (F,M,S) on a knot's state, of this size S."""
        p = self.state_count
        placed = np.zeros((*rows.shape[:2], size))
        for j in range(len(self.white)):
            placed[:, j, j * p : (j + 1) * p] = rows[:, j]
        return placed

    def read_encoders(self, states: Array) -> Array:
        """What an encoder reads (…,I,M) of means or columns of states (p,…,I,M)."""
        if self.error is None or self.at_link.all():
            return np.asarray(states[0])
        return np.asarray(states[0] + np.where(self.at_link, 0.0, states[MOTION_ORDER]))

    def add_to_readings(self, states: Array, amount: Array) -> None:
        """Add to means or columns of states (p,…,I,M) in place what encoders read of: the
        transpose of `read_encoders`.
        """
        states[0] += amount
        if self.error is not None:
            states[MOTION_ORDER] += np.where(self.at_link, 0.0, amount)

    def advance_states(self, states: Array, gap: Array, decay: Array) -> None:
        """Move means or columns of states (p,…,I,M) in place by gaps
        (I,1) s, over which errors keep `decay` (I,M).
        """
        states[0] += gap * states[1]
        states[0] += 0.5 * gap * gap * states[2]
        states[1] += gap * states[2]
        if self.error is not None:
            states[MOTION_ORDER] *= decay

    def carry_slopes_back(self, states: Array, gap: Array, decay: Array) -> None:
        """Move slopes by states (p,…,I,M) in place to those before
        gaps (I,1) s: the transpose of `advance_states`.
        """
        states[2] += gap * states[1] + 0.5 * gap * gap * states[0]
        states[1] += gap * states[0]
        if self.error is not None:
            states[MOTION_ORDER] *= decay

    def compute_gained_covariance(self, gap: Array, unit_motion: Array) -> Array:
        """Covariances (p,p,…,M) that the state gains over gaps (…) s, over which
        motion gains unit_motion (3,3,…) for a process of variance 1.
        """
        found = np.zeros((self.state_count, self.state_count, *gap.shape, len(self.white)))
        found[:MOTION_ORDER, :MOTION_ORDER] = unit_motion[..., None] * self.process
        if self.error is not None:
            lost = np.expm1(-2.0 * gap[..., None] / self.seconds)
            found[MOTION_ORDER, MOTION_ORDER] = -self.error_variance * lost
        return found

"""A joint's angle at any sighting: smoothed along a motion, or as read in a still pose."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...types import Array
from .angle_smoother import ReadingChain, WhiteMotion, covariance_between_times, smooth_angles

STILL = 1e-3
"""rad: assumed std of encoders in still poses, which
poses alone do not determine; a servo's resolution.
"""
FORGOTTEN = 8.0
"""Time constants after which what lasts is taken to be gone: 3e-4 of it would be left."""
_SAME = 1e-6


class Angles(Protocol):
    """One joint in one log."""

    @property
    def t(self) -> Array:
        """Times (K,) s of the readings."""

    def at(self, t: Array) -> tuple[Array, Array]:
        """Angle (N,) rad at the times t (N,) s, NaN where unknown, and its variance (N,) rad²."""

    def coupling(self, t: Array) -> tuple[Array, Array, Array]:
        """Covariance of the errors between times t (N,)
        s ascending: rows i > columns j, value (L,) rad².
        """


@dataclass(frozen=True, eq=False)
class Moving:
    """A moving joint with its chain of readings, and the error of its encoder
    that lasts: std rad and seconds, an Ornstein–Uhlenbeck process.
    """

    chain: ReadingChain
    motion: WhiteMotion
    std: float = 0.0
    seconds: float = 1.0

    @property
    def t(self) -> Array:
        """Times (K,) s of its nodes."""
        return self.chain.t

    def at(self, t: Array) -> tuple[Array, Array]:
        """The smoothed angle."""
        mean, variance = smooth_angles(self.chain, self.motion, t)
        return mean, variance + self.std**2

    def coupling(self, t: Array) -> tuple[Array, Array, Array]:
        """Smoothing correlates the errors of neighbours, and what lasts is common to them."""
        near = covariance_between_times(self.chain, self.motion, t)
        if not self.std:
            return near
        i, j = np.tril_indices(len(t), -1)
        apart = np.abs(t[i] - t[j]) / self.seconds
        kept = apart < FORGOTTEN
        # a product of two covariances is one; this one ends, and is exp(-apart) to 0.005
        left = 1.0 - apart[kept] / FORGOTTEN
        value = self.std**2 * np.exp(-apart[kept] * (1.0 - 1.0 / FORGOTTEN)) * left
        lasting = (i[kept], j[kept], value)
        first, second, third = (np.concatenate(both) for both in zip(near, lasting, strict=True))
        return first, second, third


@dataclass(frozen=True, eq=False)
class Posed:
    """A joint in still poses: times t (K,) s ascending
    and readings z (K,) rad, independent of each other.
    """

    t: Array
    z: Array

    def at(self, t: Array) -> tuple[Array, Array]:
        """The reading of the same pose; its noise counts as part of each track's residual."""
        rows = np.clip(np.searchsorted(self.t, t - _SAME), 0, len(self.t) - 1)
        same = np.abs(self.t[rows] - t) <= _SAME
        return np.where(same, self.z[rows], np.nan), np.zeros(len(t))

    def coupling(self, t: Array) -> tuple[Array, Array, Array]:
        """Errors of poses are independent."""
        nothing = np.zeros(0, np.int64)
        return nothing, nothing, np.zeros(0)


def poses_with_readings(t: Array, z: Array) -> Posed:
    """The poses with a finite reading z (N,) rad at t (N,) s, by time."""
    rows = np.flatnonzero(np.isfinite(z) & np.isfinite(t))
    rows = rows[np.argsort(t[rows], kind="stable")]
    return Posed(t[rows], z[rows])


def motion_of_resting_joint() -> WhiteMotion:
    """A placeholder motion for joints with still poses only: unknown, with encoder noise STILL."""
    return WhiteMotion(2, 1.0, STILL**2, 0.0, (float("inf"), float("inf")))

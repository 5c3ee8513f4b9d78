"""Smooth paths of the joints, exact at any instant:
position (N,M) rad and rate (N,M) rad/s at times t (N,) s.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..types import Array


@dataclass(frozen=True)
class Motion:
    """A path: position(t) and rate(t), both (N,M) for t (N,) in s."""

    position: Callable[[Array], Array]
    rate: Callable[[Array], Array]


def stand_still(pose: Array) -> Motion:
    """No motion: `pose` (M,) at all times."""
    return Motion(lambda t: np.tile(pose, (len(t), 1)), lambda t: np.zeros((len(t), len(pose))))


def wander_through_points(points: Array, pace: float) -> Motion:
    """A spline through points (K,M), `pace` s apart, at rest at both ends."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(np.arange(len(points)) * pace, points, bc_type="clamped")
    return Motion(spline, spline.derivative())


def reach_between_points(points: Array, pace: float) -> Motion:
    """Minimum-jerk reaches (Flash & Hogan 1985) from
    each of points (K,M) to the next, each `pace` s long.
    """
    steps = np.diff(points, axis=0)

    def locate(t: Array) -> tuple[Array, Array]:
        index = np.clip((t // pace).astype(int), 0, len(steps) - 1)
        return index, np.clip(t / pace - index, 0.0, 1.0)[:, None]

    def position(t: Array) -> Array:
        index, s = locate(t)
        return np.asarray(points[index] + steps[index] * s**3 * (10 - 15 * s + 6 * s**2))

    def rate(t: Array) -> Array:
        index, s = locate(t)
        return np.asarray(steps[index] * 30 * s**2 * (1 - s) ** 2 / pace)

    return Motion(position, rate)


def spread_points(count: int, swing: Array, rng: np.random.Generator) -> Array:
    """`count` points (K,M) spread evenly over the box
    ±swing (M,): a Kronecker sequence with a random start.

    The step of each of the m axes that move is a power of the
    root of x^(m+1) = x + 1 (the plastic number's family).
    """
    moved = np.flatnonzero(swing)
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (len(moved) + 1))
    steps = root ** -np.arange(1.0, len(moved) + 1)
    points = np.zeros((count, len(swing)))
    points[:, moved] = (
        2.0 * ((rng.random(len(moved)) + np.outer(np.arange(1, count + 1), steps)) % 1.0) - 1.0
    )
    return np.asarray(points * swing)

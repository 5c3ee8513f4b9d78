"""A head that turns about the vertical while the arm moves, its camera with it: to the body it is one more joint."""

from dataclasses import dataclass, replace

import numpy as np

from ..types import Array
from .camera import Camera

JOINT = "head_pan_joint"
SWING = 0.1
_PERIODS = np.array([3.1, 5.3])


@dataclass(frozen=True, eq=False)
class Head:
    """Two sines of `phase` (2,) rad, together at most SWING rad to either side."""

    phase: Array

    def angle(self, t: Array) -> Array:
        """Where it looks at t (N,) s: (N,) rad to the left of the arm's home."""
        return np.asarray(SWING / 2 * np.sin(t[:, None] * 2 * np.pi / _PERIODS + self.phase).sum(axis=1))

    def rate(self, t: Array) -> Array:
        """How fast it turns at t (N,) s: (N,) rad/s."""
        w = 2 * np.pi / _PERIODS
        return np.asarray(SWING / 2 * (w * np.cos(t[:, None] * w + self.phase)).sum(axis=1))


def turned(camera: Camera, angle: float) -> Camera:
    """The camera turned to the left about the vertical through it by `angle` rad."""
    c, s = np.cos(angle), np.sin(angle)
    return replace(camera, rotation=camera.rotation @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))

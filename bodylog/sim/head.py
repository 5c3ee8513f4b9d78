"""Further joints that move independently: a head that
turns its camera, a gripper that opens and closes.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..types import Array
from .camera import PinholeCamera

JOINT = "head_pan_joint"
SWING = 0.1


@dataclass(frozen=True, eq=False)
class Sway:
    """Two sines of `phase` (2,) rad and `periods` (2,)
    s, together at most `swing` rad to either side.
    """

    joint: str
    swing: float
    periods: Array
    phase: Array

    def angle(self, t: Array) -> Array:
        """The joint's angle (N,) rad at t (N,) s."""
        return np.asarray(
            self.swing / 2 * np.sin(t[:, None] * 2 * np.pi / self.periods + self.phase).sum(axis=1)
        )

    def rate(self, t: Array) -> Array:
        """The joint's speed (N,) rad/s at t (N,) s."""
        w = 2 * np.pi / self.periods
        return np.asarray(self.swing / 2 * (w * np.cos(t[:, None] * w + self.phase)).sum(axis=1))


def head_sway(rng: np.random.Generator) -> Sway:
    """A head that turns about the vertical as the arm moves: to the body it is one more joint."""
    return Sway(JOINT, SWING, np.array([3.1, 5.3]), rng.uniform(0.0, 2 * np.pi, 2))


def gripper_sway(rng: np.random.Generator) -> Sway:
    """A gripper, whose motion no image shows."""
    return Sway("gripper_joint", 0.4, np.array([4.1, 1.9]), rng.uniform(0.0, 2 * np.pi, 2))


def turn_camera(camera: PinholeCamera, angle: float) -> PinholeCamera:
    """The camera turned to the left about the vertical through it by `angle` rad."""
    c = np.cos(angle)
    s = np.sin(angle)
    return replace(
        camera, rotation=camera.rotation @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    )

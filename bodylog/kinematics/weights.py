"""What a robot's joints carry: gravity's torque about each, by the masses of its links.

The z axis of the robot's root is upright.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..types import Array
from .chain import Chain, chain_between
from .robot import Robot

GRAVITY = 9.81
"""m/s²."""


@dataclass(frozen=True, eq=False)
class Weights:
    """What a robot's joints carry: mass, kg · centre (3,), m, of a link · chain to it."""

    parts: tuple[tuple[float, Array, Chain], ...]

    def torques(self, q: Array) -> Array:
        """Gravity's torque (N,M) about each joint, N m (N where it slides), at q (N,M)."""
        found = np.zeros(q.shape)
        for mass, centre, chain in self.parts:
            poses = chain.at(q)
            place = poses.place + poses.rotation @ centre
            # minus the derivative of the height
            found -= mass * GRAVITY * chain.slopes(poses, place[:, None])[:, 0, 2]
        return found


def collect_weights(robot: Robot, joints: Sequence[str], still: Mapping[str, float]) -> Weights:
    """The weights beyond the joints; other joints are held at `still` (rad or m), or at 0."""
    found = []
    for link, (mass, centre) in robot.masses.items():
        chain = chain_between(robot, robot.root, link)
        if mass > 0.0 and set(chain.joints) & set(joints):
            held = {name: still.get(name, 0.0) for name in chain.joints if name not in joints}
            found.append((mass, centre, chain.holding(held).over(tuple(joints))))
    return Weights(tuple(found))

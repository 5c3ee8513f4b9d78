"""A robot that is known by the poses of one frame
alone: six joints without zeros carry the frame.
"""

from collections.abc import Sequence

import numpy as np

from ..types import Array
from .robot import Joint, Robot

BASE = "base"
"""The link in which the poses are given."""


def frame_robot(frame: str, coordinates: Sequence[str]) -> Robot:
    """A robot whose last link is `frame`; its joints are the
    coordinates NAME.x, .y, .z (m), .rz, … (rad), in order.

    Each joint slides along, or turns about, the axis in its name.
    """
    links = [BASE, *(f"{frame}/{name.rpartition('.')[2]}" for name in coordinates[:-1]), frame]
    joints = []
    for name, parent, child in zip(coordinates, links[:-1], links[1:], strict=True):
        motion = name.rpartition(".")[2]
        kind = "continuous" if motion.startswith("r") else "prismatic"
        joints.append(
            Joint(name, kind, parent, child, np.eye(4), _unit_axis(motion.removeprefix("r")[0]))
        )
    return Robot(frame, tuple(links), tuple(joints), f"the poses of {frame}")


def _unit_axis(letter: str) -> Array:
    return np.asarray(np.eye(3)["xyz".index(letter)])

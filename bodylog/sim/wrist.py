"""A camera on the arm: it looks along the last link, at a feature in the scene."""

from dataclasses import dataclass, replace

import numpy as np

from ..types import Array
from .camera import Camera
from .world import matrix

DISTANCE = 0.55
"""Distance (m) of the feature from the camera when the arm is at home."""

LINK = "effector"
"""The link that carries the camera."""


@dataclass(frozen=True, eq=False)
class Mount:
    """The camera's mount: the origin of link number `link`, looking along its z."""

    link: int


def mounted(mount: Mount, camera: Camera, places: Array, turns: Array) -> Camera:
    """The camera for links at positions (L,3) m with orientations (L,4) xyzw."""
    return replace(camera, position=places[mount.link], rotation=np.asarray(matrix(turns[mount.link]).T))

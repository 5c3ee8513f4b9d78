"""A camera on the arm: it looks along the last link, and what it tracks stands in the scene."""

from dataclasses import dataclass, replace

import numpy as np

from ..types import Array
from .camera import Camera
from .world import matrix

DISTANCE = 0.55
"""How far (m) before the camera the feature stands when the arm is at home."""

LINK = "effector"
"""The link that carries the camera."""


@dataclass(frozen=True, eq=False)
class Mount:
    """Where the camera sits: at the origin of link number `link`, looking along its z."""

    link: int


def mounted(mount: Mount, camera: Camera, places: Array, turns: Array) -> Camera:
    """The camera when links stand at places (L,3) m, turned by turns (L,4) xyzw."""
    return replace(camera, position=places[mount.link], rotation=np.asarray(matrix(turns[mount.link]).T))

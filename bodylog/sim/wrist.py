"""A camera on the arm: it looks along the last link, at a feature in the scene."""

from dataclasses import dataclass, replace

import numpy as np

from ..types import Array
from .camera import PinholeCamera
from .world import matrix_from_quaternion

DISTANCE = 0.55
"""Distance (m) of the feature from the camera when the arm is at home."""

LINK = "effector"
"""The link that carries the camera."""


@dataclass(frozen=True, eq=False)
class Mount:
    """The camera's mount: the origin of link number `link`, looking along its z."""

    link: int


def camera_on_mount(
    mount: Mount, camera: PinholeCamera, places: Array, turns: Array
) -> PinholeCamera:
    """The camera for links at positions (L,3) m with orientations (L,4) xyzw."""
    return replace(
        camera,
        position=places[mount.link],
        rotation=np.asarray(matrix_from_quaternion(turns[mount.link]).T),
    )

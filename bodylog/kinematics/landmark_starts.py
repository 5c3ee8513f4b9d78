"""Where a camera may stand before landmarks are known: on
a link that bears its name, or anywhere around the arm.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from ..types import Array
from .joint_names import telling_words
from .landmark_fit import search_delay
from .landmarks import LandmarkModel, LandmarkSightings
from .links import ANYWHERE, FRAME_POSE, CameraHint, hinted_camera
from .rig import RigCamera
from .robot import Robot, is_optical
from .rotations import invert_transform, make_transform

_FORWARD_X = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""An optical frame (z forward, x right) in a camera's body frame (x forward, z up; REP 103)."""
_AZIMUTHS = np.arange(8) * np.pi / 4.0
_ELEVATIONS_RAD = np.radians([15.0, 35.0, 60.0])
_DISTANCES_M = (0.8, 1.5)
FINALISTS = 4


def camera_links(robot: Robot) -> list[str]:
    """Links that bear a camera's name, optical frames
    first: camera_link, d435_link, zed_left_camera_frame.
    """
    named = [link for link in robot.links if is_optical(link) or _bears_camera_name(link)]
    return sorted(named, key=lambda link: (not is_optical(link), link.count("_")))


def _bears_camera_name(link: str) -> bool:
    lower = link.lower()
    models = ("d405", "d415", "d435", "d455", "camera", "realsense", "zed", "kinect")
    return any(model in lower for model in models) or "cam" in telling_words(link)


def nominal_camera(name: str, link: str, hint: CameraHint, robot: Robot) -> RigCamera:
    """A camera on a link that bears its name: the link is
    its optical frame, or its body frame with x forward.
    """
    camera = hinted_camera(name, link, replace(hint, link=None, pose=None), robot)
    anchor = (
        np.eye(4) if is_optical(link) else invert_transform(make_transform(_FORWARD_X, np.zeros(3)))
    )
    return replace(camera, anchor=anchor, doubt=np.concatenate([FRAME_POSE, camera.doubt[6:]]))


def free_camera(name: str, hint: CameraHint, robot: Robot) -> RigCamera:
    """A camera that stands anywhere around the robot's base."""
    camera = hinted_camera(name, robot.root, replace(hint, link=None, pose=None), robot)
    return replace(camera, doubt=np.concatenate([np.full(6, ANYWHERE), camera.doubt[6:]]))


def around_the_arm(camera: RigCamera, centre: Array) -> Iterator[RigCamera]:
    """Yield the camera, upright, at 48 places on spheres
    around a centre (3,) m in its link, looking at it.
    """
    for distance in _DISTANCES_M:
        for elevation in _ELEVATIONS_RAD:
            for azimuth in _AZIMUTHS:
                level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
                outward = np.cos(elevation) * level + np.sin(elevation) * np.array([0.0, 0.0, 1.0])
                forward = -outward
                right = np.cross(forward, [0.0, 0.0, 1.0])
                right /= np.linalg.norm(right)
                turn = np.stack([right, np.cross(forward, right), forward])
                place = centre + distance * outward
                yield replace(camera, anchor=make_transform(turn, -turn @ place))


def best_starts(
    model: LandmarkModel, seen: LandmarkSightings, cameras: Iterable[RigCamera]
) -> list[tuple[LandmarkModel, Array, float]]:
    """The cameras' models with the delay of least cost, the FINALISTS of least cost first."""
    found = []
    for camera in cameras:
        there = replace(model, rig=replace(model.rig, cameras=(camera,)))
        phi, cost = search_delay(there, there.prior[0].copy(), seen)
        found.append((there, phi, cost))
    found.sort(key=lambda start: start[2])
    return found[:FINALISTS]

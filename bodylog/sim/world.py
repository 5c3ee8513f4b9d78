"""The arm in PyBullet: posed exactly, never simulated, and rendered without a window."""

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..io.extras import require_module
from ..types import Array
from .arms import Arm
from .camera import FAR, NEAR, PinholeCamera
from .scene import Box, Cylinder

EFFECTOR_RADIUS = 0.025
MARKER_RADIUS = 0.055
HAND_RADIUS = 0.035
_FINE = 300


@dataclass(frozen=True)
class World:
    """An arm in a PyBullet client: link names in URDF order, `joints` as PyBullet numbers them."""

    bullet: Any
    client: int
    body: int
    links: tuple[str, ...]
    joints: tuple[int, ...]

    def pose(self, q: Array) -> tuple[Array, Array]:
        """Put joints at q (M,) rad: positions (L,3) m, orientations (L,4) xyzw of all links."""
        for joint, angle in zip(self.joints, q, strict=True):
            self.bullet.resetJointState(self.body, joint, float(angle), physicsClientId=self.client)
        numbers = list(range(len(self.links)))
        states = self.bullet.getLinkStates(self.body, numbers, 0, True, physicsClientId=self.client)
        return np.array([state[4] for state in states]), np.array([state[5] for state in states])

    def cylinders(self) -> Iterator[Cylinder]:
        """Yield the cylinders that the links are drawn as."""
        for shape in self.bullet.getVisualShapeData(self.body, physicsClientId=self.client):
            link = shape[1]
            kind = shape[2]
            sizes = shape[3]
            place = shape[5]
            turn = shape[6]
            if link >= 0 and kind == self.bullet.GEOM_CYLINDER:
                yield Cylinder(
                    self.links[link],
                    np.array(place),
                    matrix_from_quaternion(np.array(turn)),
                    sizes[1],
                    sizes[0],
                )

    def furnish(self, boxes: Sequence[Box]) -> None:
        """Put boxes into the world, where the arm does not touch them."""
        for box in boxes:
            shape = self.bullet.createVisualShape(
                self.bullet.GEOM_BOX,
                halfExtents=box.half,
                rgbaColor=[*box.colour, 1.0],
                physicsClientId=self.client,
            )
            place = box.place.tolist()
            turn = quaternion_from_matrix(box.rotation).tolist()
            self.bullet.createMultiBody(0, -1, shape, place, turn, physicsClientId=self.client)

    def picture(self, camera: PinholeCamera, wall: Array) -> tuple[Array, Array]:
        """The arm in front of `wall` (H,W,3): RGB (H,W,3) uint8, depth along the view (H,W) m."""
        import cv2

        small = _halve_if_fine(camera)
        colour, depth = self._render(small)
        before = cv2.resize(wall, (small.width, small.height), interpolation=cv2.INTER_AREA)
        cv2.copyTo(cv2.cvtColor(colour, cv2.COLOR_RGBA2RGB), (depth < FAR).astype(np.uint8), before)
        size = camera.width, camera.height
        return cv2.resize(before, size), cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST)

    def _render(self, camera: PinholeCamera) -> tuple[Array, Array]:
        """RGBA (H,W,4) uint8 and depth (H,W) m, FAR where nothing is."""
        shot = self.bullet.getCameraImage(
            camera.width,
            camera.height,
            _view_matrix(camera),
            _projection_matrix(camera),
            shadow=0,
            renderer=self.bullet.ER_TINY_RENDERER,
            flags=self.bullet.ER_NO_SEGMENTATION_MASK,
            physicsClientId=self.client,
        )
        colour = np.asarray(shot[2], np.uint8).reshape(camera.height, camera.width, 4)
        buffer = np.asarray(shot[3], np.float32).reshape(camera.height, camera.width)
        return colour, np.where(
            buffer < 1.0, FAR * NEAR / (FAR - (FAR - NEAR) * buffer), np.float32(FAR)
        )


@contextmanager
def open_world(arm: Arm) -> Iterator[World]:
    """The arm, loaded in its own PyBullet client; UsageError when PyBullet is not installed."""
    with _silence_stderr():
        pybullet = require_module("pybullet")
        client = pybullet.connect(pybullet.DIRECT)
        body = pybullet.loadURDF(str(arm.urdf), useFixedBase=True, physicsClientId=client)
    try:
        yield _world_of_body(pybullet, client, body, arm)
    finally:
        pybullet.disconnect(client)


def _world_of_body(bullet: Any, client: int, body: int, arm: Arm) -> World:
    count = bullet.getNumJoints(body, physicsClientId=client)
    infos = [bullet.getJointInfo(body, number, physicsClientId=client) for number in range(count)]
    numbers = {info[1].decode(): info[0] for info in infos}
    links = tuple(info[12].decode() for info in infos)
    # The effector is drawn by camera.sphere, with soft edges.
    bullet.changeVisualShape(
        body, links.index("effector"), rgbaColor=[0, 0, 0, 0], physicsClientId=client
    )
    return World(bullet, client, body, links, tuple(numbers[name] for name in arm.joints))


def matrix_from_quaternion(xyzw: Array) -> Array:
    """Rotation matrix (3,3) of a unit quaternion (4,)."""
    x, y, z, w = xyzw
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + 2 * w * cross + 2 * cross @ cross)


def quaternion_from_matrix(rotation: Array) -> Array:
    """Unit quaternion (4,) xyzw of a rotation (3,3):
    the eigenvector of Bar-Itzhack's symmetric matrix.
    """
    r = rotation
    k = np.zeros((4, 4))
    k[:3, :3] = r + r.T - np.trace(r) * np.eye(3)
    k[3, :3] = [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]
    k[:3, 3] = k[3, :3]
    k[3, 3] = np.trace(r)
    vector = np.linalg.eigh(k)[1][:, -1]
    return np.asarray(vector * np.sign(vector[3]))


def _halve_if_fine(camera: PinholeCamera) -> PinholeCamera:
    """The camera at half its size where that is fine enough
    for the arm: a quarter of the time, and smoother edges.
    """
    if camera.width < _FINE or camera.width % 2 or camera.height % 2:
        return camera
    whole = None if camera.whole_height is None else camera.whole_height // 2
    return replace(
        camera,
        width=camera.width // 2,
        height=camera.height // 2,
        focal=camera.focal / 2,
        first_row=camera.first_row // 2,
        whole_height=whole,
    )


def _view_matrix(camera: PinholeCamera) -> list[float]:
    """OpenGL view matrix, column major: x right, y up, z towards the viewer."""
    view = np.eye(4)
    view[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ camera.rotation
    view[:3, 3] = -view[:3, :3] @ camera.position
    return [float(value) for value in view.T.ravel()]


def _projection_matrix(camera: PinholeCamera) -> list[float]:
    """OpenGL projection matrix, column major, of the same pinhole.

    The renderer samples the lower right corner of each
    pixel: a shift of half a pixel moves that to its centre.
    Of rows alone the centre lies `below` their middle.
    """
    matrix = np.zeros((4, 4))
    matrix[0, 0] = 2 * camera.focal / camera.width
    matrix[1, 1] = 2 * camera.focal / camera.height
    below = camera.centre[1] - (camera.height - 1) / 2
    matrix[0, 2] = 1 / camera.width
    matrix[1, 2] = (1 + 2 * below) / camera.height
    matrix[2, 2] = -(FAR + NEAR) / (FAR - NEAR)
    matrix[2, 3] = -2 * FAR * NEAR / (FAR - NEAR)
    matrix[3, 2] = -1.0
    return [float(value) for value in matrix.T.ravel()]


@contextmanager
def _silence_stderr() -> Iterator[None]:
    """Silence PyBullet's C code, which writes its build time to file descriptor 2 when imported."""
    sys.stderr.flush()
    kept = os.dup(2)
    nothing = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nothing, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(nothing)
        os.close(kept)

"""A forward model with a chain of found axes as its mean."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from ...kinematics.axis_chain import AxisChain
from ...kinematics.axis_hand import CameraHand, MarkerHand
from ...kinematics.axis_instant import compile_axes
from ...kinematics.instant import Instant
from ...kinematics.rotations import invert_transform, make_transform, rotation_from_vector
from ...sources import group_of
from ...types import Array
from .mean_gp import MeanAt
from .posed_gp import PosedGP


@dataclass(frozen=True, eq=False)
class AxisGP(PosedGP):
    """One marker before one camera or tracker, on joints whose axes were found without a URDF.

    chain: the axes of greatest posterior; its unknowns are those of `AxisChain.move_axes`.
    """

    chain: AxisChain

    @property
    def length_unit(self) -> str:
        """Shares of the marker's distance, "1", before a camera; "m" before a tracker."""
        return "1" if len(self.chain.lens) else "m"

    @property
    def shares_unknowns(self) -> bool:
        """Each track has a chain of its own."""
        return False

    def name_poses(self, track: str) -> tuple[str, str]:
        """The camera's name, and the marker's with its camera: each has axes of its own."""
        camera = track.rpartition("/")[0]
        return f"camera {camera}".strip(), group_of(track)

    def move_unknowns(self, step: Array) -> Self:
        """The model with its unknowns changed by step (P,)."""
        return replace(self, chain=self.chain.move_axes(step))

    def move_poses(self, camera: Array, marker: Array) -> tuple[Self, Array, Array]:
        """The model after its camera (6,) and its marker (3,) moved, and the derivatives (P,6) and
        (P,3) of its unknowns by both there.
        """
        chain, by_camera, by_marker = self.chain.move_poses(camera, marker)
        return replace(self, chain=chain), by_camera, by_marker

    def locate_pose(self, kind: str, change: Array) -> Array:
        """Pose (4,4) of the camera in that before it moved, or of the marker in its axes."""
        if kind == "marker":
            return make_transform(np.eye(3), change)
        return invert_transform(make_transform(rotation_from_vector(change[3:]), change[:3]))

    @cached_property
    def hands(self) -> tuple[MarkerHand, CameraHand]:
        """What the arm may hold, which nothing tells: the marker, or the camera."""
        return MarkerHand(self.chain), CameraHand(self.chain)

    def _evaluate_mean(self, x: Array) -> MeanAt:
        return self.chain.see(x)

    def _evaluate_mean_once(self, x: Array) -> MeanAt:
        return self._instant(x)

    @cached_property
    def _instant(self) -> Instant:
        return compile_axes(self.chain)

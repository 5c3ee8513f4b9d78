"""A forward model whose camera and marker may move after the exploration."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Self

import numpy as np

from ...kinematics.hand import Hand
from ...types import Array
from .mean_gp import MeanGP


@dataclass(frozen=True, eq=False)
class PosedGP(MeanGP):
    """One marker before one camera or tracker.

    A camera moves by (6,), v and then w: all that it sees goes from p to exp(w) p + v. A marker
    moves by (3,), or by (6,) where it turns. Lengths are in `length_unit`, turns in rad.
    """

    @property
    @abstractmethod
    def length_unit(self) -> str:
        """Unit of lengths: "m", or "1" for shares of the marker's distance."""

    @property
    @abstractmethod
    def shares_unknowns(self) -> bool:
        """Whether all tracks of a body have the same unknowns, of one robot in one unit."""

    @property
    def knows_zeros(self) -> bool:
        """Whether joints read their angles for certain, so that no zero can have changed."""
        return False

    @property
    def marker_freedom(self) -> int:
        """K: the numbers by which the marker moves; a point does not turn."""
        return 3

    @property
    def marker_point(self) -> Array:
        """The point (3,) of the marker that is seen, in the marker."""
        return np.zeros(3)

    @property
    def hands(self) -> tuple[Hand, ...]:
        """What the arm may hold; none where nothing tells the levers."""
        return ()

    @abstractmethod
    def name_poses(self, track: str) -> tuple[str, str]:
        """The names of the camera and the marker of this model's track."""

    def slides(self, joint: int) -> bool:
        """Whether a joint is prismatic."""
        return False

    @abstractmethod
    def move_unknowns(self, step: Array) -> Self:
        """The model with the mean's unknowns changed by step (P,)."""

    @abstractmethod
    def move_poses(self, camera: Array, marker: Array) -> tuple[Self, Array, Array]:
        """The model after its camera (6,) and its marker (K,) moved, and the derivatives (P,6) and
        (P,K) of its unknowns by both there.
        """

    @abstractmethod
    def locate_pose(self, kind: str, change: Array) -> Array:
        """Pose (4,4) of the camera or the marker, as `kind` says, in its link, moved by a change.

        Without a URDF the link of a camera is where it was, and a marker's has the camera's axes.
        """

"""A forward model with kinematics and a camera as
its mean, and a Gaussian process on the residuals.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from ...body_model import UNUSED_URDF, BodyModel
from ...errors import ModelError
from ...kinematics.instant import Instant, compile_predictor
from ...kinematics.pose import Base, bend_still_joints, rise_in_base
from ...kinematics.rig import Rig, Sight
from ...kinematics.rotations import invert_transform
from ...types import Array
from ..gp.mean_gp import MeanAt
from ..gp.posed_gp import PosedGP

LEAST_ZERO_STD = 1e-6
"""rad or m: prior std of zeros below which `fit --offset-prior 0` has turned them off."""


@dataclass(frozen=True, eq=False)
class KinematicGP(PosedGP):
    """One point of one marker before one camera; the fields
    of GP are those of the residual, whose mean is zero.

    rig: one camera, one marker, one sight of one point · theta (P,), the unknowns, of greatest
    posterior · base: the chain from the robot's root to the marker, or to a moving camera, if that
    is known.

    printed (P,): θ of the calibration, which has the least error without the process · resting
    (K+1,4,4): the fixed steps of the chain with the zeros of joints that stood still, as printed;
    None where none did.
    """

    rig: Rig
    theta: Array
    printed: Array
    base: Base | None = None
    resting: Array | None = None

    @property
    def length_unit(self) -> str:
        """Metres, as in the URDF."""
        return "m"

    @property
    def shares_unknowns(self) -> bool:
        """All tracks are learned with one URDF."""
        return True

    @property
    def knows_zeros(self) -> bool:
        """Whether offsets are turned off."""
        return bool((self.rig.doubt < LEAST_ZERO_STD).all())

    @property
    def marker_point(self) -> Array:
        """The point (3,) m of the marker that is seen, in the marker."""
        return np.asarray(self.rig.sights[0].points[0])

    def name_poses(self, track: str) -> tuple[str, str]:
        """The names in the rig."""
        return self.rig.cameras[0].name, self.rig.carriers[0].name

    def slides(self, joint: int) -> bool:
        """Whether a joint is prismatic, by the URDF."""
        return self.rig.slides(joint)

    @property
    def marker_freedom(self) -> int:
        """K: a board has a rotation, too."""
        return len(self.rig.carriers[0].doubt)

    def move_unknowns(self, step: Array) -> Self:
        """The model with its unknowns changed by step (P,)."""
        return replace(self, theta=self.theta + step)

    def move_poses(self, camera: Array, marker: Array) -> tuple[Self, Array, Array]:
        """The model after its camera (6,) and its marker (K,) moved, both as `Rig` has their
        unknowns, and the derivatives (P,6) and (P,K) of its own by both.
        """
        first = self.rig.of_camera(0).start
        carrier = self.rig.of_carrier(0)
        every = np.eye(len(self.theta))
        by_camera = every[:, first : first + 6]
        by_marker = every[:, carrier]
        step = by_camera @ camera + by_marker @ marker
        moved = replace(self, theta=self.theta + step, printed=self.printed + step)
        return moved, by_camera, by_marker

    def locate_pose(self, kind: str, change: Array) -> Array:
        """Pose (4,4), m, of the camera or the marker, as `kind` says, in its link."""
        rig = self.rig
        theta = self.theta.copy()
        place = rig.of_camera(0) if kind == "camera" else rig.of_carrier(0)
        theta[place.start : place.start + len(change)] += change
        return (
            invert_transform(rig.camera_pose(0, theta))
            if kind == "camera"
            else rig.carrier_pose(0, theta)
        )

    def kinematics(self, x: Array) -> Array:
        """Predict at x (N,M) rad by the calibration alone: (N,D) px."""
        return self.kinematics_of_points(x, self.rig.sights[0].points)[:, 0]

    def kinematics_of_points(self, x: Array, points: Array) -> Array:
        """Predict points (C,3) m of the marker at x (N,M) rad by the calibration: (N,C,2) px."""
        sight = replace(self._printed_sight, points=points)
        return np.asarray(self.rig.see(sight, self.printed, np.atleast_2d(x)).image)

    @property
    def hands(self) -> tuple[Self, ...]:
        """What the arm holds: the marker or camera that the robot's root carries; the root stands
        upright.
        """
        return () if self.base is None else (self,)

    @property
    def is_upright(self) -> bool:
        """Whether it is known which way a weight pulls."""
        return True

    def measure_levers(self, x: Array) -> Array:
        """How far the hand rises with each joint (N,M,1), m per rad, at x (N,M) rad: minus the
        torque of a unit weight there. There must be a hand.
        """
        assert self.base is not None
        return rise_in_base(self.base, self.rig, self.theta, x)[..., None]

    @property
    def still_joints(self) -> tuple[str, ...]:
        """Names (R,) of joints that stood still in the exploration and may carry the hand."""
        return () if self.base is None else self.base.still_joints

    def show_still_joints(self, x: Array) -> tuple[Array, Array]:
        """What each joint that stood still moves the marker's image by (N,D,R), px per rad or m,
        and how far the hand rises with it (N,R,1), m, at x (N,M) rad.
        """
        if self.base is None or self.base.hand is None:
            return np.zeros((len(x), len(self.drift), 0)), np.zeros((len(x), 0, 1))
        moved, rise = bend_still_joints(self.base, self.rig, self.theta, x)
        place = self.rig.of_camera(0) if self.base.camera else self.rig.of_carrier(0)
        by_place = self.design(x)[:, :, place.start : place.start + 3]
        return by_place @ moved, rise[..., None]

    @property
    def offsets(self) -> tuple[Array, Array]:
        """The joints' zeros (M,) rad or m, and their covariance (M,M)."""
        part = self.rig.of_joints
        return self.theta[part], np.asarray(self.root[part] @ self.root[part].T)

    @property
    def _printed_sight(self) -> Sight:
        """The sight with the zeros of joints that stood still."""
        sight = self.rig.sights[0]
        if self.resting is None:
            return sight
        return replace(sight, chain=replace(sight.chain, fixed=self.resting))

    @cached_property
    def _instant(self) -> Instant:
        return compile_predictor(self.rig, self.theta)

    def _evaluate_mean(self, x: Array) -> MeanAt:
        seen = self.rig.see(self.rig.sights[0], self.theta, x)
        return seen.image[:, 0], seen.slope[:, 0], seen.design[:, 0]

    def _evaluate_mean_once(self, x: Array) -> MeanAt:
        return self._instant(x)


def can_show_changes(body: BodyModel) -> bool:
    """Whether a body can show changes: it has the joints' axes, of a URDF or found without one, and
    its encoders read angles.
    """
    return "encoders" not in body.senses and any(
        isinstance(s, PosedGP) for s in body.senses.values()
    )


def kinematic_senses(body: BodyModel, lacking: str) -> dict[str, KinematicGP]:
    """The senses with a URDF's chain; ModelError without
    any: what is lacking, and why the URDF given is not used.
    """
    senses = {name: sense for name, sense in body.senses.items() if isinstance(sense, KinematicGP)}
    if not senses:
        why = body.provenance.get(UNUSED_URDF)
        todo = f"as {why}" if why else "type: bodylog fit LOG --urdf ROBOT.urdf"
        raise ModelError(
            f"learned without a URDF, so without {lacking}{', ' if why else '; '}{todo}"
        )
    return senses

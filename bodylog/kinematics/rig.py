"""A rig: cameras, trackers and markers on links, their unknowns
θ in one vector, and the image or space points they predict.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..types import Array
from .camera import project_points, scale_points
from .chain import Chain
from .rotations import cross_product_matrix, left_jacobian, make_transform, rotation_from_vector

IMAGES = 0
SPACE = 1
"""Kinds of measurements, each with one noise: px² in images, mm² of points in space."""


@dataclass(frozen=True, eq=False)
class RigCamera:
    """A camera on a link: anchor (4,4), the link in the camera, m · lens (6,), prior mean · doubt
    (12,): prior std of both.

    A tracker, which measures points in space, has no lens: lens (0,), doubt (6,).
    The pose's unknowns move the anchor: p ↦ exp(w) p + v, v in m and w in rad, in the camera.
    """

    name: str
    link: str
    anchor: Array
    lens: Array
    doubt: Array

    @property
    def tracks_space(self) -> bool:
        """Whether it measures points in space, in mm, and not in images."""
        return len(self.lens) == 0


@dataclass(frozen=True, eq=False)
class Carrier:
    """A marker on a link: anchor (4,4), the marker in the link,
    m · doubt (3,) or (6,): prior std of place (and rotation).

    A point has only a place; a rigid board also a rotation.
    """

    name: str
    link: str
    anchor: Array
    doubt: Array

    @property
    def turns(self) -> bool:
        """Whether its rotation is unknown as well."""
        return len(self.doubt) == 6


@dataclass(frozen=True, eq=False)
class Sight:
    """One marker before one camera: chain from the camera's
    link to the marker's · points (C,3) of the marker, m.

    by_log: (camera, carrier) in each log where one of them
    moved between logs; empty where they are the same in all.
    """

    name: str
    camera: int
    carrier: int
    chain: Chain
    points: Array = field(default_factory=lambda: np.zeros((1, 3)))
    by_log: tuple[tuple[int, int], ...] = ()

    def in_log(self, log: int) -> "Sight":
        """The sight with its camera and its marker where they are in a log."""
        if not self.by_log:
            return self
        camera, carrier = self.by_log[log]
        return replace(self, camera=camera, carrier=carrier, by_log=())


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras, markers, sights, and joints (M,) with the prior
    std of their offsets (M,) rad or m; all unknowns are θ (P,).

    θ: each camera's pose (6) and lens (6 or 0), each marker's place (3) or place and rotation (6),
    each joint's offset δ, and each joint's scale s where `scale_doubt` is (M,) and not empty: a
    joint that reads q is at (1 + s) q + δ. Where `sag_doubt` is (M,) and not empty, each joint has
    a compliance c, readings are (N,2M) with the torques τ beside q, and it is at
    (1 + s) q + δ + c τ.
    lenses: the camera whose lens each camera has, itself if
    empty; a camera that moved between logs keeps its lens.
    """

    cameras: tuple[RigCamera, ...]
    carriers: tuple[Carrier, ...]
    sights: tuple[Sight, ...]
    joints: tuple[str, ...]
    doubt: Array
    scale_doubt: Array = field(default_factory=lambda: np.zeros(0))
    lenses: tuple[int, ...] = ()
    sag_doubt: Array = field(default_factory=lambda: np.zeros(0))

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Prior mean (P,) and standard deviation (P,) of θ."""
        mean = [np.concatenate([np.zeros(6), one.lens]) for one in self.cameras]
        mean += [np.zeros(len(one.doubt)) for one in self.carriers]
        std = [*(one.doubt for one in self.cameras), *(one.doubt for one in self.carriers)]
        zeros = np.zeros(len(self.joints) + len(self.scale_doubt) + len(self.sag_doubt))
        std = [*std, self.doubt, self.scale_doubt, self.sag_doubt]
        return np.concatenate([*mean, zeros]), np.concatenate(std)

    def of_camera(self, index: int) -> slice:
        """A camera's 12 unknowns in θ; a tracker's 6."""
        begin = sum(len(one.doubt) for one in self.cameras[:index])
        return slice(begin, begin + len(self.cameras[index].doubt))

    def of_lens(self, index: int) -> slice:
        """The 6 unknowns of a camera's lens in θ; none of a tracker."""
        whole = self.of_camera(self.lenses[index] if self.lenses else index)
        return slice(whole.start + 6, whole.stop)

    def of_carrier(self, index: int) -> slice:
        """A marker's 3 or 6 unknowns in θ."""
        begin = sum(len(one.doubt) for one in self.cameras)
        begin += sum(len(one.doubt) for one in self.carriers[:index])
        return slice(begin, begin + len(self.carriers[index].doubt))

    @cached_property
    def kinds(self) -> Array:
        """What each sight is of, (S,): IMAGES, or SPACE."""
        return np.array([int(self.cameras[one.camera].tracks_space) for one in self.sights])

    def split_by_kind(self) -> Iterator[tuple[int, "Rig", list[int]]]:
        """Yield each kind, the rig with its sights alone, and their numbers."""
        for kind in np.unique(self.kinds).tolist():
            rows = np.flatnonzero(self.kinds == kind).tolist()
            yield kind, replace(self, sights=tuple(self.sights[k] for k in rows)), rows

    @property
    def of_joints(self) -> slice:
        """The joints' offsets in θ."""
        end = self.of_sag.start - len(self.scale_doubt)
        return slice(end - len(self.joints), end)

    @property
    def of_scales(self) -> slice:
        """The joints' scales in θ; empty where scales are fixed."""
        return slice(self.of_joints.stop, self.of_sag.start)

    @property
    def of_sag(self) -> slice:
        """The joints' compliances in θ; empty where there is no sag."""
        end = len(self.prior[0])
        return slice(end - len(self.sag_doubt), end)

    def angles(self, theta: Array, q: Array) -> Array:
        """Joint angles, rad or m, for readings q (N,M)."""
        count = len(self.joints)
        angles = self.gain(theta) * q[:, :count] + theta[self.of_joints]
        if len(self.sag_doubt):
            angles = angles + theta[self.of_sag] * q[:, count:]
        return np.asarray(angles)

    def gain(self, theta: Array) -> Array:
        """Joint motion (M,) per unit of reading."""
        scales = theta[self.of_scales]
        return 1.0 + scales if len(scales) else np.ones(len(self.joints))

    def see(
        self, sight: Sight, theta: Array, q: Array, log: Array | None = None
    ) -> "RigPrediction":
        """Predict a sight at joint readings q (N,M), rad or m, for unknowns theta (P,).

        log (N,): the log of each row, for a sight that differs between logs; without it, that of
        its own camera and marker.
        """
        if log is None or not sight.by_log:
            return _predict_sight(self, sight, theta, q)
        seen = _predict_sight(self, sight, theta, q)
        for number in np.unique(log):
            rows = np.flatnonzero(log == number)
            part = _predict_sight(self, sight.in_log(int(number)), theta, q[rows])
            for name in ("image", "slope", "design", "stretch"):
                getattr(seen, name)[rows] = getattr(part, name)
        return seen

    def slides(self, joint: int) -> bool:
        """Whether a joint is prismatic, by the first chain that contains it."""
        chains = (one.chain for one in self.sights)
        return next(
            (bool(c.slides[list(c.column).index(joint)]) for c in chains if joint in c.column),
            False,
        )

    def alone(self, index: int, log: int | None = None) -> tuple["Rig", Array]:
        """Return the rig of one sight, as it is in a log if
        one is given, and the indices of θ (P,) that it keeps.
        """
        sight = self.sights[index] if log is None else self.sights[index].in_log(log)
        pose = self.of_camera(sight.camera)
        parts = (
            slice(pose.start, pose.start + 6),
            self.of_lens(sight.camera),
            self.of_carrier(sight.carrier),
            self.of_joints,
            self.of_scales,
            self.of_sag,
        )
        used = np.concatenate([np.arange(part.start, part.stop) for part in parts])
        camera = self.cameras[sight.camera]
        carrier = self.carriers[sight.carrier]
        one = replace(sight, camera=0, carrier=0, by_log=())
        return replace(self, cameras=(camera,), carriers=(carrier,), sights=(one,), lenses=()), used

    def camera_pose(self, index: int, theta: Array) -> Array:
        """The camera's link in the camera (4,4), m."""
        return np.asarray(
            _transform_of_unknowns(theta[self.of_camera(index)][:6]) @ self.cameras[index].anchor
        )

    def carrier_pose(self, index: int, theta: Array) -> Array:
        """The marker in its link (4,4), m."""
        return np.asarray(
            _transform_of_unknowns(theta[self.of_carrier(index)]) @ self.carriers[index].anchor
        )


@dataclass(frozen=True, eq=False)
class RigPrediction:
    """image (N,C,2) px · slope (N,C,2,M) by the joints, px per rad or m · design (N,C,2,P) by θ.

    stretch (N,C,2,K−1) px: by the lengths between the chain's steps, each in shares of itself.
    Of a tracker, 3 and mm in place of 2 and px.
    """

    image: Array
    slope: Array
    design: Array
    stretch: Array


def _transform_of_unknowns(unknowns: Array) -> Array:
    turn = unknowns[3:] if len(unknowns) == 6 else np.zeros(3)
    return make_transform(rotation_from_vector(turn), unknowns[:3])


def _predict_sight(rig: Rig, sight: Sight, theta: Array, q: Array) -> RigPrediction:
    camera = rig.cameras[sight.camera]
    carrier = rig.carriers[sight.carrier]
    own = theta[rig.of_camera(sight.camera)][:6]
    lens = theta[rig.of_lens(sight.camera)]
    mine = theta[rig.of_carrier(sight.carrier)]
    poses = sight.chain.at(rig.angles(theta, q))
    marker, by_marker = _shift_points(
        sight.points @ carrier.anchor[:3, :3].T + carrier.anchor[:3, 3], mine
    )
    linked = marker @ poses.rotation.transpose(0, 2, 1) + poses.place[:, None]
    placed = linked @ camera.anchor[:3, :3].T + camera.anchor[:3, 3]
    inside, by_pose = _shift_points(placed, own)
    image, by_point, by_lens = (
        scale_points(inside) if camera.tracks_space else project_points(inside, lens)
    )
    turn = by_point @ (rotation_from_vector(own[3:]) @ camera.anchor[:3, :3])
    by_angle = turn @ sight.chain.slopes(poses, linked)
    design = np.zeros((*image.shape, len(theta)))
    design[..., rig.of_camera(sight.camera)][..., :6] = by_point @ by_pose
    design[..., rig.of_lens(sight.camera)] = by_lens
    design[..., rig.of_carrier(sight.carrier)] = (turn @ poses.rotation[:, None]) @ by_marker
    design[..., rig.of_joints] = by_angle
    if len(rig.scale_doubt):
        design[..., rig.of_scales] = by_angle * q[:, None, None, : len(rig.joints)]
    if len(rig.sag_doubt):
        design[..., rig.of_sag] = by_angle * q[:, None, None, len(rig.joints) :]
    slope = by_angle * rig.gain(theta)
    return RigPrediction(image, slope, design, turn @ poses.strides.transpose(0, 2, 1)[:, None])


def _shift_points(points: Array, unknowns: Array) -> tuple[Array, Array]:
    """exp(w) p + v of points (…,3), and its derivatives (…,3,3) by v or (…,3,6) by v and w."""
    by_place = np.broadcast_to(np.eye(3), (*points.shape, 3))
    if len(unknowns) == 3:
        return points + unknowns, by_place
    turned = points @ rotation_from_vector(unknowns[3:]).T
    by_turn = -cross_product_matrix(turned) @ left_jacobian(unknowns[3:])
    return turned + unknowns[:3], np.concatenate([by_place, by_turn], axis=-1)

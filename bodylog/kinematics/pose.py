"""Poses of a marker or camera in the robot's base, with
covariance: forward kinematics of angles and unknowns.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..types import Array
from .chain import Chain, chain_between
from .links import Space
from .rig import Rig
from .robot import Robot
from .rotations import invert_transform, vector_from_rotation

LEAST_LEVER = 1e-3
"""m (or m per m), or shares of the marker's distance: below it no joint carries the hand, as of an
arm whose axes are all upright.
"""
_STEP = 1e-6


@dataclass(frozen=True, eq=False)
class Base:
    """The chain from the robot's root to a rig's marker,
    or to its camera where the marker does not move.

    chain: from the root to the thing's link · tool (4,4): a frame on that link, named `link`, that
    gives a point marker its orientation · camera: whether the thing is the camera's optical frame.
    hand: the chain from the root to the tool or camera, with the rig's joints and then those that
    stood still and do not carry the other of marker and camera, at `still` (R,) rad or m; None
    where there are none.
    """

    chain: Chain
    tool: Array
    link: str
    camera: bool = False
    hand: Chain | None = None
    still: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def still_joints(self) -> tuple[str, ...]:
        """Names (R,) of the joints that stood still."""
        return () if self.hand is None else self.hand.joints[len(self.chain.joints) :]


def find_base(robot: Robot, rig: Rig, theta: Array, still: Mapping[str, float]) -> Base | None:
    """Find the chain from the root to the rig's marker or camera; None where neither moves.

    theta (P,): the rig's unknowns · still: angles, rad or m, of joints that did not move.
    """
    space = Space(robot, rig.joints, still, 1.0)
    for link, camera in ((rig.carriers[0].link, False), (rig.cameras[0].link, True)):
        chain = space.chain(robot.root, link)
        if len(chain.column):
            place = rig.carrier_pose(0, theta)[:3, 3]
            tool, name = (
                (np.eye(4), link)
                if camera
                else _nearest_tool_frame(robot, link, place, rig.joints, still)
            )
            other = rig.carriers[0].link if camera else rig.cameras[0].link
            hand = _chain_to_hand(robot, rig, name, other, still)
            rests = np.array([still.get(one, 0.0) for one in hand.joints[len(rig.joints) :]])
            base = Base(chain, tool, name, camera)
            return replace(base, hand=hand, still=rests) if len(rests) else base
    return None


def _chain_to_hand(
    robot: Robot, rig: Rig, hand: str, other: str, still: Mapping[str, float]
) -> Chain:
    """The chain from the root to the hand's frame by the rig's joints, and by those that stood
    still and do not carry the other link.
    """
    whole = chain_between(robot, robot.root, hand)
    common = chain_between(robot, robot.root, other).joints
    others = [one for one in whole.joints if one not in rig.joints]
    held = {one: still.get(one, 0.0) for one in others if one in common}
    further = [one for one in others if one not in common]
    return whole.holding(held).over((*rig.joints, *further))


def _nearest_tool_frame(
    robot: Robot, link: str, place: Array, moving: Sequence[str], still: Mapping[str, float]
) -> tuple[Array, str]:
    """The end frame fixed to a link that is nearest to a place (3,) m on it, and its name."""
    found = []
    for name in robot.links:
        chain = chain_between(robot, link, name)
        if not set(chain.joints) & set(moving):
            held = chain.holding({joint: still.get(joint, 0.0) for joint in chain.joints})
            found.append((held.fixed[0], name))
    parents = {joint.parent for joint in robot.joints}
    ends = [one for one in found if one[1] not in parents] or found
    return min(ends, key=lambda one: float(np.linalg.norm(one[0][:3, 3] - place)))


def pose_in_base(
    base: Base, rig: Rig, theta: Array, root: Array, q: Array, cov: Array
) -> tuple[Array, Array, Array]:
    """Place (N,3) m, rotation (N,3,3) and covariance (N,6,6) of the thing in the robot's base.

    At angles q (N,M) ± cov (N,M,M), rad or m, for unknowns theta (P,) with covariance root rootᵀ.
    The covariance is of the place, m, and of a small rotation about the base's axes, rad.
    """
    poses = base.chain.at(rig.angles(theta, q))
    on_link, by_theta = _on_link(base, rig, theta)
    place = poses.place + poses.rotation @ on_link[:3, 3]
    rotation = poses.rotation @ on_link[:3, :3]
    by_joints = np.zeros((len(q), 6, len(rig.joints)))
    by_joints[:, :3] = base.chain.slopes(poses, place[:, None])[:, 0]
    for k, slides in enumerate(base.chain.slides):
        if not slides:
            by_joints[:, 3:, base.chain.column[k]] += base.chain.scale[k] * poses.axes[:, k]
    by = np.zeros((len(q), 6, len(theta)))
    by[:, :3] = poses.rotation @ by_theta[:3]
    by[:, 3:] = poses.rotation @ by_theta[3:]
    by[..., rig.of_joints] += by_joints
    if len(rig.scale_doubt):
        by[..., rig.of_scales] += by_joints * q[:, None]
    by_joints = by_joints * rig.gain(theta)
    unknown = by @ root
    spread = by_joints @ cov @ by_joints.transpose(0, 2, 1) + unknown @ unknown.transpose(0, 2, 1)
    return place, rotation, spread


def rise_in_base(base: Base, rig: Rig, theta: Array, q: Array) -> Array:
    """How far the thing rises with each joint (N,M), m
    per rad or per m, at q (N,M), for unknowns theta (P,).
    """
    poses = base.chain.at(rig.angles(theta, q))
    place = poses.place + poses.rotation @ _place_thing_on_link(base, rig, theta)[:3, 3]
    return np.asarray(base.chain.slopes(poses, place[:, None])[:, 0, 2])


def bend_still_joints(base: Base, rig: Rig, theta: Array, q: Array) -> tuple[Array, Array]:
    """How the marker's first point moves with each joint that stood still (N,3,R), on the marker's
    link, or in the camera if the arm holds that, and how far what it holds rises with it (N,R): m
    per rad or per m, at q (N,M), for theta (P,).

    Whether such a joint is between the link and the hand,
    or beyond both, is not known: here all are between.
    """
    assert base.hand is not None
    angles = rig.angles(theta, q)
    link = base.chain.at(angles)
    on_link = _place_thing_on_link(base, rig, theta)
    marker = _place_marker_on_link(base, rig, theta, angles)
    point = link.place + (link.rotation @ marker[..., None])[..., 0]
    held = link.place + link.rotation @ on_link[:3, 3] if base.camera else point
    every = np.concatenate([angles, np.broadcast_to(base.still, (len(q), len(base.still)))], axis=1)
    both = np.stack([point, held], axis=1)
    slopes = base.hand.slopes(base.hand.at(every), both)[..., len(rig.joints) :]
    moves = link.rotation.swapaxes(1, 2) @ slopes[:, 0]
    return (-on_link[:3, :3].T @ moves if base.camera else moves), slopes[:, 1, 2]


def _place_marker_on_link(base: Base, rig: Rig, theta: Array, angles: Array) -> Array:
    """The marker's first point (N,3) m, on the link of what the arm holds."""
    pose = rig.carrier_pose(0, theta)
    point = pose[:3, :3] @ rig.sights[0].points[0] + pose[:3, 3]
    if not base.camera:
        return np.broadcast_to(point, (len(angles), 3))
    link = rig.sights[0].chain.at(angles)
    return np.asarray(link.rotation @ point + link.place)


def _on_link(base: Base, rig: Rig, theta: Array) -> tuple[Array, Array]:
    """The thing's pose (4,4) on its link and its derivatives
    (6,P) by θ: place, m, and rotation in the link.
    """
    found = _place_thing_on_link(base, rig, theta)
    by = np.zeros((6, len(theta)))
    part = rig.of_camera(0) if base.camera else rig.of_carrier(0)
    for k in range(part.start, part.start + 6 if base.camera else part.stop):
        step = _STEP * (np.arange(len(theta)) == k)
        above = _place_thing_on_link(base, rig, theta + step)
        below = _place_thing_on_link(base, rig, theta - step)
        by[:3, k] = (above[:3, 3] - below[:3, 3]) / (2.0 * _STEP)
        by[3:, k] = vector_from_rotation(above[:3, :3] @ below[:3, :3].T) / (2.0 * _STEP)
    return found, by


def _place_thing_on_link(base: Base, rig: Rig, theta: Array) -> Array:
    """The camera's optical frame or the marker on its
    link (4,4); a point has the tool's orientation.
    """
    if base.camera:
        return invert_transform(rig.camera_pose(0, theta))
    pose = rig.carrier_pose(0, theta)
    if not rig.carriers[0].turns:
        pose = pose.copy()
        pose[:3, :3] = base.tool[:3, :3]
    return pose

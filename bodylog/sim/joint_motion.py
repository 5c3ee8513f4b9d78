"""Where motors and links are while an arm is driven
along a path, for joints with play, sag and stick-slip.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..kinematics import chain, urdf
from ..kinematics.weights import GRAVITY, collect_weights
from ..types import Array
from .arms import Arm
from .hardware import Hardware, add_play, add_stick
from .motion import Motion

_GRID_HZ = 200.0
_HALF_STEP_S = 1e-4


@dataclass(frozen=True)
class DrivenMotion:
    """Paths of the motors, which encoders read; of the links, which cameras
    see; and of the links in the frame of the encoders during the
    exploration, in which sag that was there already is no error: the truth.
    """

    motors: Motion
    links: Motion
    truth: Motion


def move_joints(commanded: Motion, hardware: Hardware, arm: Arm, duration: float) -> DrivenMotion:
    """The motion of joints that are driven along the commanded path for `duration` s."""
    if not hardware.bends:
        return DrivenMotion(commanded, commanded, commanded)
    t = np.arange(0.0, duration + 1.0 / _GRID_HZ, 1.0 / _GRID_HZ)
    path = commanded.position(t)
    driven = add_stick(path, hardware.stick)
    behind = driven - path
    slack = add_play(driven, hardware.play) - driven
    loaded = _load_shares(arm)
    weighed = _torque_shares(arm)

    def motors(at: Array) -> Array:
        return commanded.position(at) + _interpolate_columns(at, t, behind)

    def bent(at: Array, sag: float) -> Array:
        angles = motors(at)
        links = angles + _interpolate_columns(at, t, slack)
        if sag:
            links = links + sag * weighed(angles)
        if hardware.payload:
            carried = hardware.payload * hardware.carries_payload(at)
            links = links + carried[:, None] * loaded(angles)
        return links

    truth = _motion_by_differences(lambda at: bent(at, 0.0))
    links = _motion_by_differences(lambda at: bent(at, hardware.sag))
    return DrivenMotion(_motion_by_differences(motors), links, truth)


def _interpolate_columns(at: Array, t: Array, values: Array) -> Array:
    """Values (K,M) at times t (K,) s, interpolated to times at (N,) s."""
    return np.column_stack([np.interp(at, t, column) for column in values.T])


def _motion_by_differences(position: Callable[[Array], Array]) -> Motion:
    """The motion along a path whose rate has no formula."""

    def rate(t: Array) -> Array:
        return (position(t + _HALF_STEP_S) - position(t - _HALF_STEP_S)) / (2.0 * _HALF_STEP_S)

    return Motion(position, rate)


def _load_shares(arm: Arm) -> Callable[[Array], Array]:
    """How far a weight at the effector turns each joint (N,M)
    at angles (N,M), where 1 is by the whole arm's length.

    A joint with a spring turns by its torque over the spring's constant; the torque of a weight is
    minus the derivative of its height by the joint.
    """
    robot = urdf.load_urdf(arm.urdf)
    hand = chain.chain_between(robot, robot.root, "effector").over(arm.joints)
    length = _stretched_length(hand)

    def shares(angles: Array) -> Array:
        poses = hand.at(angles)
        return -hand.slopes(poses, poses.place[:, None])[:, 0, 2] / length

    return shares


def _torque_shares(arm: Arm) -> Callable[[Array], Array]:
    """The torque (N,M) of the links' masses about each joint at angles
    (N,M), where 1 is that of the whole arm stretched out.
    """
    weights = collect_weights(urdf.load_urdf(arm.urdf), arm.joints, {})
    largest = sum(
        GRAVITY * mass * (_stretched_length(to_link) + float(np.linalg.norm(centre)))
        for mass, centre, to_link in weights.parts
        if len(to_link.fixed) > 2
    )
    return lambda angles: weights.torques(angles) / largest


def _stretched_length(to_link: chain.Chain) -> float:
    """Length (m) of a chain beyond its first joint, which stands upright: it carries nothing."""
    return float(np.linalg.norm(to_link.fixed[2:, :3, 3], axis=1).sum())

"""Adjust the calibration that is printed: alone, and
with the zeros of joints that stood still as unknowns.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...kinematics.adjustment import Adjusted, Known, Posed, adjust
from ...kinematics.chain import chain_between
from ...kinematics.identifiability import GIVEN
from ...kinematics.links import FoundLinks, Space
from ...kinematics.rig import Rig
from ...kinematics.robot import Robot
from ...types import Array, Features, Series
from ..data.pairs import Pairs
from ..senses import encoder_function
from .placements import Calibration, calibration_of, printed_unknowns
from .sag import Sag
from .sightings import ThingSightings

STRETCHES = 30
"""Parts of a log whose images are left out together:
images next to each other have the same errors.
"""


@dataclass(frozen=True, eq=False)
class Recording:
    """What a log says beside its sightings: joints, readings or None · start and duration, s ·
    poses: rows are still poses that were measured one by one.
    """

    joints: Series | None
    start: float
    duration: float
    poses: bool


@dataclass(frozen=True, eq=False)
class Resting:
    """Joints that stood still, whose zeros count all the same.

    still: their angles, rad or m · doubt: prior std of zeros, rad.
    """

    robot: Robot
    still: Mapping[str, float]
    doubt: float


def recorded_logs(features: Sequence[Features]) -> tuple[Recording, ...]:
    """Each log's joints and times."""
    found = []
    for one in features:
        joints = encoder_function.with_true_angles(one, None).joints
        times = joints.t if joints is not None and len(joints.t) else np.zeros(1)
        found.append(Recording(joints, float(times[0]), float(times[-1] - times[0]), one.poses))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What an adjustment takes from beside the sightings:
    the logs · resting joints, if the robot is at hand.
    """

    logs: tuple[Recording, ...]
    resting: Resting | None = None


def adjust_calibration(
    links: FoundLinks,
    parts: Mapping[str, ThingSightings],
    beside: Surroundings,
    theta: Array,
    covariance: Array,
    sag: Sag | None = None,
) -> tuple[Calibration, Adjusted, Adjusted]:
    """The calibration of least error, the adjustment behind it,
    and that of the body's own unknowns, as printed.

    parts: the sightings, one for each sight.
    theta (P,), covariance (P,P): of the rig of `links` beside a process of residuals. With sag its
    own θ and covariance take their place, and each joint's compliance is one more unknown.
    """
    rig = links.calibrated.rig
    start = links.calibrated.theta
    names = tuple[str, ...]()
    rows = np.arange(len(theta))
    if beside.resting is not None:
        names = _resting_joints(rig, beside.resting)
        rig, start = _widened(rig, start, names, beside.resting)
    # zeros of further joints stand after the others, before the scales
    moved = np.where(rows < links.calibrated.rig.of_scales.start, rows, rows + len(names))
    known = Known(moved, theta, covariance)
    if sag is not None:
        doubt = np.concatenate(
            [np.full(len(sag.compliance), sag.doubt), np.full(len(names), _FIXED)]
        )
        rig = replace(rig, sag_doubt=doubt)
        start = np.concatenate([start, np.zeros(len(doubt))])
        sagging = rig.of_sag.start + np.arange(len(sag.compliance))
        mean = np.concatenate([sag.theta, sag.compliance])
        known = Known(np.concatenate([moved, sagging]), mean, sag.covariance)
    groups = _groups([one.whole for one in parts.values()], beside.logs)
    data = [
        _posed(one, group, names, beside.logs, sag)
        for one, group in zip(parts.values(), groups, strict=True)
    ]
    found = adjust(rig, data, start, links.calibrated.noise, known)
    own = np.ix_(moved, moved)
    given = printed_unknowns(found)
    narrow = links.calibrated.rig
    if names:
        zeros = dict(zip(rig.joints, given[rig.of_joints], strict=True))
        narrow = _with_resting_zeros(narrow, zeros, beside.resting)
    printed = replace(
        found,
        rig=narrow,
        theta=given[moved],
        covariance=found.covariance[own],
        curvature=found.curvature[own],
    )
    return calibration_of(found), found, printed


def _with_resting_zeros(rig: Rig, zeros: Mapping[str, float], resting: Resting | None) -> Rig:
    """The rig without further joints, held where they stood, their zeros included."""
    if resting is None:
        return rig
    still = {name: angle + zeros.get(name, 0.0) for name, angle in resting.still.items()}
    space = Space(resting.robot, rig.joints, still, resting.doubt)
    chains = [space.chain(one.chain.start, one.chain.end) for one in rig.sights]
    sights = [replace(one, chain=chain) for one, chain in zip(rig.sights, chains, strict=True)]
    return replace(rig, sights=tuple(sights))


def _resting_joints(rig: Rig, resting: Resting) -> tuple[str, ...]:
    """Joints between cameras and markers that stood
    still and have readings; none where zeros are given.
    """
    if resting.doubt <= GIVEN:
        return ()
    ways = [
        chain_between(resting.robot, one.chain.start, one.chain.end).joints for one in rig.sights
    ]
    found = dict.fromkeys(name for way in ways for name in way)
    return tuple(name for name in found if name in resting.still and name not in rig.joints)


def _widened(rig: Rig, theta: Array, names: tuple[str, ...], resting: Resting) -> tuple[Rig, Array]:
    """The rig and θ with further joints, whose zeros are 0 at first and whose scales stay 1."""
    if not names:
        return rig, theta
    joints = (*rig.joints, *names)
    space = Space(resting.robot, joints, resting.still, resting.doubt)
    sights = tuple(
        replace(one, chain=space.chain(one.chain.start, one.chain.end)) for one in rig.sights
    )
    doubt = np.concatenate([rig.doubt, space.zero_std(names)])
    scaled = len(rig.scale_doubt) > 0
    scale_doubt = np.concatenate([rig.scale_doubt, np.full(len(names) if scaled else 0, _FIXED)])
    wide = replace(rig, joints=joints, sights=sights, doubt=doubt, scale_doubt=scale_doubt)
    theta = np.insert(theta, [rig.of_joints.stop] * len(names), 0.0)
    return wide, np.concatenate([theta, np.zeros(len(names) if scaled else 0)])


_FIXED = 1e-9
"""Prior std of what is held."""


def _posed(
    one: ThingSightings,
    group: Array,
    names: Sequence[str],
    logs: Sequence[Recording],
    sag: Sag | None,
) -> Posed:
    """Sightings for the adjustment, with the readings of further joints, and with the torques."""
    further = np.zeros((len(one.whole.x), len(names)))
    for log in np.unique(one.whole.log):
        rows = np.flatnonzero(one.whole.log == log)
        further[rows] = _readings(logs[log], names, one.whole.t[rows])
    readings = [one.whole.x, further]
    if sag is not None:
        readings += [sag.weights.torques(one.whole.x), np.zeros(further.shape)]
    sighted = replace(one.sighted, q=np.concatenate(readings, axis=1))
    variance = np.concatenate([one.whole.variance, np.zeros(further.shape)], axis=1)
    return Posed(sighted, variance, one.whole.log, group)


def _readings(log: Recording, names: Sequence[str], t: Array) -> Array:
    """Readings (N,K), rad or m, of joints at times t (N,) s, by the readings before and after."""
    found = np.zeros((len(t), len(names)))
    for k, name in enumerate(names):
        if log.joints is not None and name in log.joints.names:
            column = log.joints.values[:, log.joints.names.index(name)]
            known = np.isfinite(column)
            found[:, k] = np.interp(t, log.joints.t[known], column[known])
    return found


def _groups(wholes: Sequence[Pairs], logs: Sequence[Recording]) -> list[Array]:
    """Numbers (N,) for each sight's images: of their
    posture, or of their stretch of the log, over all sights.
    """
    keys = []
    for whole in wholes:
        part = whole.t.copy()
        for log in np.unique(whole.log[whole.log >= 0]):
            one = logs[log]
            rows = whole.log == log
            if not one.poses and one.duration > 0.0:
                part[rows] = np.floor(STRETCHES * (whole.t[rows] - one.start) / one.duration)
        keys.append(np.column_stack([whole.log, part]))
    numbers = np.unique(np.concatenate(keys), axis=0, return_inverse=True)[1].reshape(-1)
    return np.split(numbers, np.cumsum([len(one) for one in keys])[:-1])

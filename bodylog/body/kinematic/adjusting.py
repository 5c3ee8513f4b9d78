"""Adjust the calibration that is printed: alone, and
with the zeros of joints that stood still as unknowns.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...kinematics.adjustment import Adjusted, Known, Posed, adjust
from ...kinematics.calibration import Calibrated
from ...kinematics.chain import chain_between
from ...kinematics.identifiability import GIVEN
from ...kinematics.links import FoundLinks, Space
from ...kinematics.rig import Rig
from ...kinematics.robot import Robot
from ...types import Array, Features
from ..data.angles import Angles
from ..data.pairs import Pairs, smooth_all_joints, sparse_joints
from ..senses import encoder_function
from .placements import Calibration, calibration_of, printed_unknowns
from .residuals import Together, solve_together
from .sag import Sag
from .sightings import ThingSightings

STRETCHES = 30
"""Parts of a log whose images are left out together:
images next to each other have the same errors.
"""


@dataclass(frozen=True, eq=False)
class Recording:
    """What a log says beside its sightings: start and duration, s · poses: rows are still poses
    that were measured one by one · still: smoothed angles of joints that stood still.
    """

    start: float
    duration: float
    poses: bool
    still: Mapping[str, Angles]


@dataclass(frozen=True, eq=False)
class Resting:
    """Joints that stood still, whose zeros count all the same.

    still: their angles, rad or m · doubt: prior std of zeros, rad.
    """

    robot: Robot
    still: Mapping[str, float]
    doubt: float


def recorded_logs(features: Sequence[Features], still: Sequence[str] = ()) -> tuple[Recording, ...]:
    """Each log's times, and its angles of joints that stood still."""
    found = []
    for log in features:
        one = encoder_function.with_true_angles(log, None)
        times = one.joints.t if one.joints is not None and len(one.joints.t) else np.zeros(1)
        angles = _smooth_still_joints(one, still)
        found.append(Recording(float(times[0]), float(times[-1] - times[0]), one.poses, angles))
    return tuple(found)


def _smooth_still_joints(log: Features, names: Sequence[str]) -> dict[str, Angles]:
    """Smoothed angles of those joints that have readings in a log: the noise of single readings
    would be an error of every image.
    """
    read = () if log.joints is None else log.joints.names
    sparse = sparse_joints([log]) if read else {}
    known = tuple(name for name in names if name in read and name not in sparse)
    return {one.name: one.angles[0] for one in smooth_all_joints([log], known)} if known else {}


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What an adjustment takes from beside the sightings:
    the logs · resting joints, if the robot is at hand.
    """

    logs: tuple[Recording, ...]
    resting: Resting | None = None


@dataclass(frozen=True, eq=False)
class Widened:
    """A rig whose unknowns include the zeros of joints that
    stood still, `names`, and what a process leaves of them.

    start (P,): θ without a process, and with those zeros at 0.
    """

    rig: Rig
    start: Array
    names: tuple[str, ...]
    both: Together


def include_resting_joints(
    found: Calibrated, both: Together, shown: Mapping[str, ThingSightings], beside: Surroundings
) -> Widened:
    """Learn the unknowns beside the process again, now with
    the zeros of joints that stood still.

    What such a zero imitates, as a tracker's turn does, is as little known as the zero itself.
    shown: the sightings, one for each sight.
    """
    resting = beside.resting
    rig = found.rig
    names = () if resting is None else _resting_joints(rig, resting)
    if resting is None or not names:
        return Widened(rig, found.theta, (), both)
    wide = _widened(rig, names, resting)
    start, theta = (_with_zeros(rig, one, wide) for one in (found.theta, both.theta))
    parts = {}
    for name, part in both.parts.items():
        further = _further_readings(shown[name].whole, names, beside.logs, resting.still)
        parts[name] = replace(part, view=replace(part.view, further=further))
    return Widened(wide, start, names, solve_together(wide, theta, parts))


def adjust_calibration(
    links: FoundLinks,
    shown: Mapping[str, ThingSightings],
    beside: Surroundings,
    wide: Widened,
    sag: Sag | None = None,
) -> tuple[Calibration, Adjusted, Adjusted]:
    """The calibration of least error, the adjustment behind it,
    and that of the body's own unknowns, as printed.

    shown: the sightings, one for each sight. With sag its own θ and covariance take the place of
    those beside the process, and each joint's compliance is one more unknown.
    """
    narrow = links.calibrated.rig
    rig = wide.rig
    theta = wide.both.theta
    std = rig.prior[1]
    covariance = std * (wide.both.root @ wide.both.root.T) * std[:, None]
    if sag is not None:
        rig = replace(rig, sag_doubt=np.full(len(sag.compliance), sag.doubt))
        theta = np.concatenate([sag.theta, sag.compliance])
        covariance = sag.covariance
    known = Known(np.arange(len(theta)), theta, covariance)
    groups = _groups([one.whole for one in shown.values()], beside.logs)
    data = [
        _posed(one, group, wide.names, beside, sag)
        for one, group in zip(shown.values(), groups, strict=True)
    ]
    start = np.concatenate([wide.start, np.zeros(len(rig.sag_doubt))])
    found = adjust(rig, data, start, links.calibrated.noise, known)
    # zeros of further joints stand after the others, before the scales
    rows = np.arange(len(narrow.prior[0]))
    own = np.where(rows < narrow.of_scales.start, rows, rows + len(wide.names))
    given = printed_unknowns(found)
    if wide.names:
        zeros = dict(zip(rig.joints, given[rig.of_joints], strict=True))
        narrow = _with_resting_zeros(narrow, zeros, beside.resting)
    printed = replace(
        found,
        rig=narrow,
        theta=given[own],
        covariance=found.covariance[np.ix_(own, own)],
        curvature=found.curvature[np.ix_(own, own)],
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


def _widened(rig: Rig, names: tuple[str, ...], resting: Resting) -> Rig:
    """The rig with further joints, whose scales stay 1."""
    joints = (*rig.joints, *names)
    space = Space(resting.robot, joints, resting.still, resting.doubt)
    sights = tuple(
        replace(one, chain=space.chain(one.chain.start, one.chain.end)) for one in rig.sights
    )
    doubt = np.concatenate([rig.doubt, space.zero_std(names)])
    scaled = len(names) if len(rig.scale_doubt) else 0
    scale_doubt = np.concatenate([rig.scale_doubt, np.full(scaled, _FIXED)])
    return replace(rig, joints=joints, sights=sights, doubt=doubt, scale_doubt=scale_doubt)


def _with_zeros(rig: Rig, theta: Array, wide: Rig) -> Array:
    """θ (P,) of a rig with further joints, whose zeros are 0."""
    further = len(wide.joints) - len(rig.joints)
    theta = np.insert(theta, [rig.of_joints.stop] * further, 0.0)
    return np.concatenate([theta, np.zeros(len(wide.scale_doubt) - len(rig.scale_doubt))])


_FIXED = 1e-9
"""Prior std of what is held."""


def _posed(
    one: ThingSightings, group: Array, names: Sequence[str], beside: Surroundings, sag: Sag | None
) -> Posed:
    """Sightings for the adjustment, with the readings of further joints, and with the torques."""
    held = {} if beside.resting is None else beside.resting.still
    further = _further_readings(one.whole, names, beside.logs, held)
    q = np.concatenate([one.whole.x, further], axis=1)
    if sag is not None:
        q = np.concatenate([q, sag.weights.torques(q)], axis=1)
    variance = np.concatenate([one.whole.variance, np.zeros(further.shape)], axis=1)
    return Posed(replace(one.sighted, q=q), variance, one.whole.log, group)


def _further_readings(
    whole: Pairs, names: Sequence[str], logs: Sequence[Recording], held: Mapping[str, float]
) -> Array:
    """Readings (N,K), rad or m, of joints that stood still, at each image; where a log has none,
    where they were held.
    """
    found = np.tile([held[name] for name in names], (len(whole.x), 1))
    for log in np.unique(whole.log) if names else ():
        rows = np.flatnonzero(whole.log == log)
        for k, name in enumerate(names):
            if name in logs[log].still:
                angles = logs[log].still[name].at(whole.t[rows])[0]
                found[rows, k] = np.where(np.isfinite(angles), angles, held[name])
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

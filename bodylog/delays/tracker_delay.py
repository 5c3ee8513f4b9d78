"""Delays of points in space, by a URDF's kinematics or by what joints that turn can do.

With a URDF each log's delay is one more unknown of the rig. A process that learns points to a
thousandth of their motion takes lateness for the arm's shape; kinematics cannot. Points at t − τ
are predicted by h(q(t), θ) + J q̇ τ to the first order.

Without one, a point that M joints turn is a sum of products of 1, sin q and cos q of each, and so
are the draws of the process ∏ ½ (1 + cos δ). Its evidence is taken at the joints' angles of each
delay, so that no slope of noisy points is needed: by slopes, 40 ms were found as 12 ± 2.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..body.data.pairs import SmoothedJoint, has_moved, smooth_all_joints
from ..body.data.trainable import FEWEST
from ..body.kinematic.learn import (
    Robotics,
    find_links_given,
    still_joint_angles,
    track_of_sightings,
)
from ..body.kinematic.sightings import ThingSightings, gather_sightings
from ..estimation.measurements.track import camera_of_track
from ..estimation.timing import correction
from ..estimation.timing.delay_profile import (
    MAX_DELAY_S,
    Delay,
    fit_profile_peak,
    measure_jackknife_error,
)
from ..kinematics.calibration import CHI_SQUARE_MEDIANS
from ..kinematics.rig import Rig
from ..settings import Settings
from ..types import Array, Features, Series

TURNS = 30
"""Most Gauss-Newton steps."""
CONVERGED_S = 1e-5
MOST_POINTS = 400
"""Most points of a track: a delay needs no more."""
STRETCHES = 30
"""Parts of a log that the jackknife leaves out: neighbours have the same errors."""
MOST_TURNED = 300
"""The same without a URDF, where the time grows with their cube."""
COARSE_S = 0.04
"""Distance of the delays that are tried first: a point is still near where it was."""
LEAST_LOG_SHARE = 0.1
"""Share of a log that is spent at either end on the delays that are compared."""
LEFT_OUT = 10
"""Parts of a log that are left out without a URDF."""
_STEP_S = 1e-3
_HALF_WEIGHT = 9.0
"""Squared residuals over their variance that have half weight."""


def measure_tracker_delays(
    features: Sequence[Features], settings: Settings, robot: Robotics, names: Sequence[str]
) -> "list[dict[str, Delay]]":
    """The delays of trackers by name in each log; empty where
    a rig does not explain their points, or does not settle.
    """
    tracks = sorted({n for f in features for n in f.tracks if camera_of_track(n) in names})
    joints = [
        joint for joint in smooth_all_joints(features, settings.body.joints) if has_moved(joint)
    ]
    moving = [joint.name for joint in joints if joint.name in robot.robot.by_name]
    late = [dict.fromkeys(names, 0.0) for _ in features]
    if len(moving) < len(joints):
        return [{} for _ in features]
    parts = gather_sightings(features, tracks, joints, 1, MOST_POINTS)
    tracks = [name for name, part in parts.items() if len(part.whole.x) >= FEWEST]
    if not tracks:
        return [{} for _ in features]
    parts = {name: parts[name] for name in tracks}
    seen = {name: track_of_sightings(name, one) for name, one in parts.items()}
    held = still_joint_angles(features, moving)
    found = find_links_given(robot, moving, held, seen, robot.hints).calibrated
    theta = found.theta
    for _ in range(TURNS):
        timely = [correction.shift_features(f, d) for f, d in zip(features, late, strict=True)]
        parts = gather_sightings(timely, tracks, joints, 1, MOST_POINTS)
        system = _DelaySystem(found.rig, list(parts.values()), joints, names, len(features))
        step, error = system.solve_step(theta)
        theta = theta + step[: len(theta)]
        steps = step[len(theta) :].reshape(len(features), len(names))
        for delays, own in zip(late, steps.tolist(), strict=True):
            for name, seconds in zip(names, own, strict=True):
                delays[name] += seconds
        if max(abs(delay) for delays in late for delay in delays.values()) > MAX_DELAY_S:
            break
        if np.abs(steps).max() < CONVERGED_S:
            return [
                {
                    name: Delay(delays[name], float(own[k]))
                    for k, name in enumerate(names)
                    if own[k] > 0.0
                }
                for delays, own in zip(late, error, strict=True)
            ]
    return [{} for _ in features]


def measure_turning_delays(
    features: Sequence[Features], settings: Settings, names: Sequence[str]
) -> list[dict[str, Delay]]:
    """The delays of trackers by name in each log without kinematics;
    empty where there are too few points, or the evidence has no top.
    """
    joints = [
        joint for joint in smooth_all_joints(features, settings.body.joints) if has_moved(joint)
    ]
    late: list[dict[str, Delay]] = [{} for _ in features]
    for number, found in enumerate(features):
        if found.joints is None:
            continue
        # all delays are compared by the same points, at times with readings of the joints
        begin, end = found.joints.t[[0, -1]]
        reach = min(MAX_DELAY_S, LEAST_LOG_SHARE * float(end - begin))
        for name in names:
            tracks = [one for n, one in found.tracks.items() if camera_of_track(n) == name]
            parts = [
                (one.t[rows], one.values[rows])
                for one in tracks
                if len(rows := _choose_rows(one, begin + reach, end - reach)) >= FEWEST
            ]
            delay = _climb_turning(joints, number, parts, reach) if joints and parts else None
            if delay is not None:
                late[number][name] = delay
    return late


def _choose_rows(track: Series, begin: float, end: float) -> Array:
    """At most MOST_TURNED rows (n,) of points (N,3) between two times (s), evenly."""
    known = np.isfinite(track.values).all(axis=1)
    seen = np.flatnonzero(known & (track.t >= begin) & (track.t <= end))
    if len(seen) <= MOST_TURNED:
        return seen
    return seen[np.linspace(0, len(seen) - 1, MOST_TURNED).astype(np.int64)]


def _climb_turning(
    joints: Sequence[SmoothedJoint], log: int, parts: Sequence[tuple[Array, Array]], reach: float
) -> Delay | None:
    """The delay, of up to `reach` s, of the greatest evidence of a log's points; None where that
    is no top. parts: times (n,) s and places (n,3) of each track.
    """

    def nats_at(delay: float, left_out: int | None = None) -> float:
        return sum(_turning_nats(joints, log, t - delay, y, left_out) for t, y in parts)

    step = COARSE_S
    steps = int(reach / step)
    grid = step * np.arange(-steps, steps + 1)
    nats = np.array([nats_at(one) for one in grid])
    top = int(np.argmax(nats))
    if top in (0, len(grid) - 1):
        return None
    delay = float(grid[top])
    # quarter the step until the top is a parabola, which it is within its own error
    while True:
        near = delay + step * np.arange(-1.0, 2.0)
        values = np.array([nats_at(one) for one in near])
        place, bend = fit_profile_peak(*values[:, None])
        if bend[0] <= 0.0 or abs(place[0]) > 1.0:
            return None
        delay += step * float(place[0])
        error = step / float(np.sqrt(bend[0]))
        if error > step or step < _STEP_S:
            break
        step *= 0.25
    without = [
        fit_profile_peak(*np.array([[nats_at(one, part)] for one in near]))[0]
        for part in range(LEFT_OUT)
    ]
    return Delay(delay, max(error, step * float(measure_jackknife_error(np.concatenate(without)))))


def _turning_nats(
    joints: Sequence[SmoothedJoint], log: int, t: Array, y: Array, left_out: int | None
) -> float:
    """ln p of points y (n,3) by a process of what turning joints do, at times t (n,) s of the
    joints; without one part of LEFT_OUT. Mean, amplitude and noise are the likeliest.
    """
    if left_out is not None:
        kept = np.arange(len(t)) * LEFT_OUT // len(t) != left_out
        t = t[kept]
        y = y[kept]
    kernel = np.ones((len(t), len(t)))
    for joint in joints:
        angle = joint.angles[log].at(t)[0]
        kernel *= 0.5 * (1.0 + np.cos(angle[:, None] - angle))
    values, vectors = np.linalg.eigh(kernel)
    squares = np.square(vectors.T @ (y - y.mean(axis=0))).sum(axis=1)
    ratios = values.clip(0.0) + 10.0 ** np.linspace(-12.0, 0.0, 49)[:, None]
    count = y.size
    nats = -0.5 * count * np.log((squares / ratios).sum(axis=1))
    return float((nats - 0.5 * y.shape[1] * np.log(ratios).sum(axis=1)).max())


@dataclass(frozen=True, eq=False)
class _DelaySystem:
    """Normal equations of a rig's unknowns and of each log's delays of the trackers `names` (K,).

    parts: sightings of each sight of the rig, in its order · logs: how many there are (L).
    """

    rig: Rig
    parts: Sequence[ThingSightings]
    joints: Sequence[SmoothedJoint]
    names: Sequence[str]
    logs: int

    def solve_step(self, theta: Array) -> tuple[Array, Array]:
        """A step (P+LK,) of θ and of the delays, and the standard errors (L,K) of these."""
        mean, std = self.rig.prior
        size = len(theta)
        count = size + self.logs * len(self.names)
        blocks = [self._sum_by_stretch(k, theta, count) for k in range(len(self.parts))]
        shares, pulls = (np.sum(part, axis=0) for part in zip(*blocks, strict=True))
        matrix = shares.sum(axis=0)
        pull = pulls.sum(axis=0)
        prior = np.zeros(count)
        prior[:size] = std**-2.0
        # a log without points of a tracker says nothing of its delay
        prior[size:] = MAX_DELAY_S**-2.0
        pull[:size] += (mean - theta) / std**2
        scale = 1.0 / np.sqrt(np.diag(matrix) + prior)
        whole = (matrix + np.diag(prior)) * scale * scale[:, None]
        step = scale * np.linalg.solve(whole, scale * pull)
        without = whole - shares * scale * scale[:, None]
        rest = pulls - np.einsum("gij,j->gi", shares, step)
        moved = scale * np.linalg.solve(without, (scale * rest)[..., None])[..., 0]
        groups = len(moved)
        error = np.sqrt(np.square(moved[:, size:]).sum(axis=0) * (groups - 1) / groups)
        return step, error.reshape(self.logs, len(self.names))

    def _sum_by_stretch(self, index: int, theta: Array, count: int) -> tuple[Array, Array]:
        """Shares (G,P,P) and (G,P) of the stretches of the logs in the normal equations."""
        part = self.parts[index]
        whole = part.whole
        sight = self.rig.sights[index]
        seen = self.rig.see(sight, theta, whole.x)
        residual = part.image[:, 0] - seen.image[:, 0]
        speed = self._joint_speeds(whole.log, whole.t)
        column = np.einsum("ndm,nm->nd", seen.slope[:, 0], speed)
        place = len(theta) + whole.log * len(self.names)
        place = place + self.names.index(self.rig.cameras[sight.camera].name)
        design = np.zeros((*residual.shape, count))
        design[..., : len(theta)] = seen.design[:, 0]
        # the point was at t − τ where the arm is now said to be: it lags by J q̇ τ
        design[np.arange(len(place)), :, place] = -column
        square = np.square(residual).sum(axis=1)
        noise = float(np.median(square)) / CHI_SQUARE_MEDIANS[residual.shape[1]]
        weight = 1.0 / (noise * (1.0 + square / (_HALF_WEIGHT * noise)))
        group = np.zeros(len(whole.t), np.int64)
        for log in np.unique(whole.log):
            rows = np.flatnonzero(whole.log == log)
            rows = rows[np.argsort(whole.t[rows], kind="stable")]
            group[rows] = log * STRETCHES + np.arange(len(rows)) * STRETCHES // len(rows)
        shares = np.zeros((self.logs * STRETCHES, count, count))
        pulls = np.zeros((self.logs * STRETCHES, count))
        heavy = design * weight[:, None, None]
        np.add.at(shares, group, heavy.transpose(0, 2, 1) @ design)
        np.add.at(pulls, group, np.einsum("ndp,nd->np", heavy, residual))
        return shares, pulls

    def _joint_speeds(self, log: Array, t: Array) -> Array:
        """Speeds (N,M) of the joints at times t (N,) s of logs (N,)."""
        speed = np.zeros((len(t), len(self.joints)))
        for number in np.unique(log):
            rows = np.flatnonzero(log == number)
            for m, joint in enumerate(self.joints):
                after, before = (
                    joint.angles[number].at(t[rows] + way)[0] for way in (_STEP_S, -_STEP_S)
                )
                speed[rows, m] = (after - before) / (2.0 * _STEP_S)
        return speed

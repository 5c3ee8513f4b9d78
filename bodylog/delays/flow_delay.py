"""A camera's delay from the motion of its picture and
of the joints, without a marker, a body or a URDF.

Flow y of a grid cell over the interval between two frames is J(q) Δq, with an unknown J that varies
smoothly with the posture q. With a Gaussian process prior on J, flow has the covariance (Δq_i ·
Δq_j) k(q_i, q_j): the delay that makes the joints' Δq explain the flow has the highest marginal
likelihood (Rasmussen & Williams 2006, section 5.4). Noise has Student's t distribution, one weight
for all cells of an interval: foreign motion and glitches have little.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..estimation.timing.delay_profile import Delay, fit_profile_peak, measure_jackknife_error
from ..types import Array, Series

EARLIEST_S = -0.3
LATEST_S = 0.5
"""Delays that are searched."""
GRID_STEP_S = 0.02
"""Distance of the delays that are tried first: a
joint's motion is correlated over more than that.
"""
FINE_STEPS_S = (0.01, 0.005)
"""Distances of the delays that are tried around the best one; a parabola gives the rest."""
MIN_EVIDENCE_NATS = 80.0
"""Least evidence for a delay over delays that are FAR_S away. Of 304 films of drawn arms 31 have
less; the delays of the others err by 11 ms rms, and one of 273 is wrong (by 85 ms). It does not
tell whether images belong to the joints: of 28 films of another episode of the same arm two have
more (86 and 163 nats), and no bound that true films pass would refuse all."""
FAR_S = 0.2
"""Distance of delays that a motion of arms tells apart: half a period of the fastest reaches."""
LEAST_KNOTS = 4
"""Fewest readings of a joint: a cubic needs four."""
LEAST_INTERVALS = 40
"""Fewest intervals between frames from which a delay is estimated."""
MOST_INTERVALS = 300
"""Intervals of one part of a log; a longer log has
several parts, as the cost grows with the cube.
"""
MOST_PARTS = 4
"""Parts of a log that are used, evenly spread."""
COMPONENTS = 6
"""Principal components of the grid's flow: twice as many change delays by less than their σ."""
POSTURE_LENGTH_RAD = 0.7
"""Length scale over which the picture's motion per joint motion changes: half a right angle."""
CONSTANT_SHARE = 0.5
"""Prior variance of the part of J that no posture changes, over that of the part that varies."""
DEGREES_OF_FREEDOM = 4.0
"""Degrees of freedom of the noise's t distribution."""
NOISE_RATIOS = np.exp(np.linspace(-9.0, 6.0, 31))
"""Ratios of the noise's variance to the mean
eigenvalue of the motion's covariance that are tried.
"""
REWEIGHTINGS = 2
"""Rounds in which intervals are weighted again."""
JACKKNIFE_BLOCKS = 8
"""Blocks of intervals that are left out in turn."""
METHOD_STD_S = 0.0025
"""Error that all episodes of a camera may share: 11 cameras of drawn worlds, five episodes each,
err by -0.5 ms in the mean, and by no more than their own errors beyond that; this is the 95 %
bound.
"""


@dataclass(frozen=True)
class FlowDelay:
    """A delay by flow (s) with its σ, and the evidence for it over other delays (nats).

    shared_std_s: the part of σ, a rolling shutter's, that another log of the same camera has alike,
    so that no mean over logs reduces it. mean_row: place of the moving cells, in image heights
    below the middle row · row_time: time (s) that a rolling shutter takes over the image, by the
    delays of upper and of lower cells, where these suffice. `joints`: indices of the joints that
    explain the flow best, `joints_nats` by how much better than any other group (infinite without
    one). `certain`: whether the evidence suffices; if not, the value must not be
    used. `edge`: whether it lies at the end of the searched range. `profile` (K,): evidence (nats)
    of the delays `list_tried_delays` (s), less that of the best of them · flow_per_motion: root
    mean square of the flow over that of the joints' steps.
    """

    delay: Delay
    nats: float
    joints: tuple[int, ...]
    edge: bool
    shared_std_s: float = 0.0
    mean_row: float = 0.0
    row_time: Delay | None = None
    joints_nats: float = float("inf")
    profile: tuple[float, ...] = ()
    flow_per_motion: float = float("nan")

    @property
    def certain(self) -> bool:
        """Whether the delay can be measured."""
        return self.nats >= MIN_EVIDENCE_NATS and not self.edge


@dataclass(frozen=True, eq=False)
class _FlowPart:
    """A stretch of a log: flow components (N,C), times (N,2) s, weights of the cells' rows (N,)."""

    components: Array
    times: Array


def estimate_flow_delay(
    joints: Series, times: Array, flow: Array, groups: Sequence[tuple[int, ...]], row_time_s: float
) -> FlowDelay | None:
    """The delay of a camera's stamps against the joints, positive where images are stamped late.

    `times` (N,2) s and `flow` (N,rows,columns,2) are of perception's GridFlow. Of `groups` of
    joints the one with the highest evidence explains the flow. `row_time_s`: time that a rolling
    shutter may take over the image; cells off its middle row are read at another time, which σ
    contains. None with too few intervals or joints at rest.
    """
    parts = _split_into_parts(times, flow, joints)
    if not parts:
        return None
    scans = [_scan_group(joints, parts, group) for group in groups if group]
    usable_scans = [scan for scan in scans if scan is not None]
    if not usable_scans:
        return None
    scan = max(usable_scans, key=lambda one: one.nats)
    others = [scan.evidence - one.evidence for one in usable_scans if one is not scan]
    delay = _refined_delay(parts, scan)
    row = _mean_row(flow)
    row_std_s = abs(row) * row_time_s
    std_s = float(np.linalg.norm([delay.std_error, row_std_s, METHOD_STD_S]))
    total = Delay(delay.seconds, std_s)
    rolling = _measure_row_time(joints, times, flow, scan, delay.seconds)
    better = min(others, default=float("inf"))
    profile = tuple((scan.profile - scan.evidence).tolist())
    ratio = _flow_per_motion(parts, scan.motion, delay.seconds)
    return FlowDelay(
        total, scan.nats, scan.group, scan.edge, row_std_s, row, rolling, better, profile, ratio
    )


def _flow_per_motion(parts: Sequence[_FlowPart], motion: "_JointMotion", delay: float) -> float:
    """Root mean square of the flow over that of the joints' steps."""
    flow2 = sum(float((part.components**2).sum()) for part in parts)
    steps = [
        motion.angles(part.times[:, 1] - delay) - motion.angles(part.times[:, 0] - delay)
        for part in parts
    ]
    steps2 = sum(float((step**2).sum()) for step in steps)
    return float(np.sqrt(flow2 / max(steps2, 1e-12)))


def _measure_row_time(
    joints: Series, times: Array, flow: Array, scan: "_GroupScan", seconds: float
) -> Delay | None:
    """Time (s) that a rolling shutter takes over the image: cells of rows that are read earlier
    show joints of an earlier time, so that their delay is longer.

    The rows are parted where either side has half of the
    motion. σ is by the curvature of the evidence alone.
    """
    share = _motion_of_rows(flow)
    if share.sum() <= 0.0:
        return None
    cut = int(np.searchsorted(np.cumsum(share) / share.sum(), 0.5))
    if not 0 < cut < len(share):
        return None
    delays = []
    variances = []
    places = []
    for half in (slice(0, cut), slice(cut, None)):
        parts = _split_into_parts(times, flow[:, half], joints)
        found, curvature = _refine_evidence_peak(parts, scan.motion, seconds)
        if curvature <= 0.0 or abs(found - seconds) > FAR_S:
            return None
        delays.append(found)
        variances.append(1.0 / curvature)
        places.append(float(share[half] @ _row_places(len(share))[half] / share[half].sum()))
    apart = places[1] - places[0]
    return Delay((delays[0] - delays[1]) / apart, float(np.sqrt(sum(variances))) / apart)


def _split_into_parts(times: Array, flow: Array, joints: Series) -> list[_FlowPart]:
    """Stretches of intervals for which the joints are known at every searched delay."""
    if not len(joints.t):
        return []
    inside = (times[:, 0] - LATEST_S > joints.t[0]) & (times[:, 1] - EARLIEST_S < joints.t[-1])
    times = times[inside]
    count = len(times)
    if count < LEAST_INTERVALS:
        return []
    components = _principal_components(flow.reshape(len(flow), -1)[inside])
    number = -(-count // MOST_INTERVALS)
    size = count // number
    chosen = np.unique(np.linspace(0, number - 1, min(number, MOST_PARTS)).round().astype(int))
    return [
        _FlowPart(components[k * size : (k + 1) * size], times[k * size : (k + 1) * size])
        for k in chosen.tolist()
    ]


def _principal_components(flow: Array) -> Array:
    """Flow (N,K) as its leading components (N,C); intervals
    beyond the 95th percentile choose them no more.
    """
    centred = flow - np.median(flow, axis=0)
    length = np.linalg.norm(centred, axis=1)
    shrink = np.minimum(1.0, np.quantile(length, 0.95) / np.maximum(length, 1e-9))
    _, _, directions = np.linalg.svd(centred * shrink[:, None], full_matrices=False)
    # a direction's sign has no meaning, but the bytes of the result should not depend on it
    leading = directions[:COMPONENTS]
    return np.asarray(centred @ leading.T)


def _motion_of_rows(flow: Array) -> Array:
    """Share (rows,) of the motion in each row of cells:
    the median over intervals (N,rows,columns,2).
    """
    energy = (flow**2).sum(axis=(2, 3))
    share = energy / np.maximum(energy.sum(axis=1, keepdims=True), 1e-12)
    return np.asarray(np.median(share, axis=0), float)


def _row_places(count: int) -> Array:
    """Places (count,) of the rows' middles, in image heights below the image's middle."""
    return (np.arange(count) + 0.5) / count - 0.5


def _mean_row(flow: Array) -> float:
    """Place of the moving cells, in image heights below
    the middle row; half an image where nothing moves.
    """
    share = _motion_of_rows(flow)
    if share.sum() <= 0.0:
        return 0.5
    return float(share @ _row_places(len(share)) / share.sum())


@dataclass(frozen=True, eq=False)
class _GroupScan:
    """The best of the delays that are tried first (s), by one group of joints, its evidence, the
    nats over far ones, and the evidence (K,) of all."""

    motion: "_JointMotion"
    group: tuple[int, ...]
    seconds: float
    evidence: float
    nats: float
    edge: bool
    profile: Array


def list_tried_delays() -> Array:
    """The delays (K,) s that are tried first."""
    return np.arange(EARLIEST_S, LATEST_S + 0.5 * GRID_STEP_S, GRID_STEP_S)


def _scan_group(
    joints: Series, parts: Sequence[_FlowPart], group: tuple[int, ...]
) -> _GroupScan | None:
    """The evidence that a group of joints gives for a delay; None where none of them moves."""
    motion = _JointMotion.of(joints, group)
    if motion is None:
        return None
    tried = list_tried_delays()
    evidence = np.sum([_scan_evidence(part, motion, tried) for part in parts], axis=0)
    best = int(np.argmax(evidence))
    far = np.abs(tried - tried[best]) > FAR_S - 0.5 * GRID_STEP_S
    nats = float(evidence[best] - evidence[far].max())
    edge = best in (0, len(tried) - 1)
    seconds = float(tried[best])
    return _GroupScan(motion, group, seconds, float(evidence[best]), nats, edge, evidence)


def _refined_delay(parts: Sequence[_FlowPart], scan: _GroupScan) -> Delay:
    """The delay of highest evidence near that of a scan, with the larger of two standard errors."""
    seconds, curvature = _refine_evidence_peak(parts, scan.motion, scan.seconds)
    std_s = curvature**-0.5 if curvature > 0.0 else LATEST_S - EARLIEST_S
    scatter_s = _jackknife_std(parts, scan.motion, seconds)
    return Delay(seconds, max(std_s, scatter_s))


@dataclass(frozen=True, eq=False)
class _JointMotion:
    """Joint angles as functions of time: a cubic spline for each joint that moves."""

    splines: tuple[Callable[[Array], Array], ...]

    @staticmethod
    def of(joints: Series, group: tuple[int, ...]) -> "_JointMotion | None":
        """The motion of those joints of a group that move; None without one."""
        from scipy.interpolate import CubicSpline

        unit = 1.0 if joints.unit == "rad" else _widest_range(joints.values[:, list(group)])
        splines: list[Callable[[Array], Array]] = []
        for number in group:
            values = joints.values[:, number]
            finite = np.isfinite(values)
            if not finite.any() or np.ptp(values[finite]) == 0.0:
                continue
            t, first = np.unique(joints.t[finite], return_index=True)
            if len(t) >= LEAST_KNOTS:
                splines.append(CubicSpline(t, values[finite][first] / unit))
        return _JointMotion(tuple(splines)) if splines else None

    def angles(self, t: Array) -> Array:
        """Joint angles (N,M) at times (N,)."""
        return np.column_stack([spline(t) for spline in self.splines])

    def covariance_and_noise(self, times: Array, delay: float) -> tuple[Array, Array]:
        """Covariance (N,N) of flow by the motion in intervals
        `times` (N,2), and relative noise variances (N,).

        Flow errs in proportion to motion as well: at silhouettes, at occlusions.
        """
        begin = self.angles(times[:, 0] - delay)
        end = self.angles(times[:, 1] - delay)
        step = end - begin
        # the mean of J over an interval is that of its middle, up to the third order
        posture = 0.5 * (begin + end)
        square = (posture**2).sum(axis=1)
        distance = np.maximum(square[:, None] + square[None] - 2.0 * posture @ posture.T, 0.0)
        similarity = CONSTANT_SHARE + np.exp(-0.5 * distance / POSTURE_LENGTH_RAD**2)
        squares = (step**2).sum(axis=1)
        return (step @ step.T) * similarity, 1.0 + squares / max(float(squares.mean()), 1e-12)


def _widest_range(values: Array) -> float:
    """The widest range of joints (N,M) whose unit is unknown: it counts as one radian."""
    finite = np.isfinite(values)
    low = np.where(finite, values, np.inf).min(axis=0)
    high = np.where(finite, values, -np.inf).max(axis=0)
    return max(float(np.where(finite.any(axis=0), high - low, 0.0).max(initial=0.0)), 1e-12)


def _scan_evidence(part: _FlowPart, motion: _JointMotion, delays: Array) -> Array:
    """Log marginal likelihood (K,) at ascending delays;
    each takes its neighbour's weights, which differ little.
    """
    weights = np.ones(len(part.times))
    found = np.empty(len(delays))
    for number, delay in enumerate(delays.tolist()):
        covariance, shape = motion.covariance_and_noise(part.times, delay)
        found[number], weights = _evidence_and_weights(part.components, covariance, shape, weights)
    return found


def _total_evidence(parts: Sequence[_FlowPart], motion: _JointMotion, delay: float) -> float:
    return sum(_part_evidence(part, motion, delay) for part in parts)


def _part_evidence(part: _FlowPart, motion: _JointMotion, delay: float) -> float:
    """Log marginal likelihood (nats) of a part's flow
    at a delay (s), noise and amplitude at their best.
    """
    covariance, shape = motion.covariance_and_noise(part.times, delay)
    weights = np.ones(len(shape))
    value = 0.0
    for _ in range(REWEIGHTINGS + 1):
        value, weights = _evidence_and_weights(part.components, covariance, shape, weights)
    return value


def _evidence_and_weights(
    components: Array, covariance: Array, shape: Array, weights: Array
) -> tuple[float, Array]:
    """Evidence with the given weights (N,), and the weights that leave-one-out residuals ask for.

    A component has the covariance s (K + r D), D = diag(shape
    / weights); s is eliminated, r is the best of a table.
    """
    count, width = components.shape
    noise = shape / weights
    root = np.sqrt(noise)
    values, vectors = np.linalg.eigh(covariance / np.outer(root, root))
    values = np.maximum(values, 0.0)
    ratios = NOISE_RATIOS * max(float(values.mean()), 1e-12)
    rotated = vectors.T @ (components / root[:, None])  # (N,C)
    power = rotated**2
    spectra = values[None] + ratios[:, None]  # (R,N)
    scales = np.maximum((1.0 / spectra) @ power / count, 1e-30)  # (R,C)
    determinants = np.log(spectra).sum(axis=1)
    evidence = -0.5 * (count * np.log(scales) + determinants[:, None] + count)
    best = evidence.argmax(axis=0)
    total = float(evidence[best, np.arange(width)].sum()) - 0.5 * width * float(np.log(noise).sum())
    total += float(0.5 * DEGREES_OF_FREEDOM * (np.log(weights) - weights + 1.0).sum())
    spread = spectra[best].T  # (N,C)
    diagonal = vectors**2 @ (1.0 / spread)
    residual = vectors @ (rotated / spread) / diagonal  # R&W (5.12)
    squares = (residual**2 * diagonal / scales[best, np.arange(width)]).sum(axis=1)
    return total, np.clip(
        (DEGREES_OF_FREEDOM + width) / (DEGREES_OF_FREEDOM + squares / weights), 1e-4, 3.0
    )


def _refine_evidence_peak(
    parts: Sequence[_FlowPart], motion: _JointMotion, delay: float
) -> tuple[float, float]:
    """The delay of highest evidence near `delay`, and
    the negative curvature of the evidence there (1/s²).
    """
    curvature = 0.0
    for step in FINE_STEPS_S:
        around = delay + step * np.array([-1.0, 0.0, 1.0])
        values = np.array([_total_evidence(parts, motion, float(x)) for x in around])
        shift, bend = fit_profile_peak(*values)
        if bend > 0.0:
            # the noise's table makes evidence uneven over milliseconds: the wider bend is kept then
            curvature = float(bend) / step**2
            delay += step * float(np.clip(shift, -1.0, 1.0))
        else:
            delay += step * (float(np.argmax(values)) - 1.0)
    return delay, curvature


def _jackknife_std(parts: Sequence[_FlowPart], motion: _JointMotion, delay: float) -> float:
    """σ of the delay (s) from delays that leave out one block of intervals each (Künsch 1989)."""
    step = FINE_STEPS_S[0]
    around = delay + step * np.array([-1.0, 0.0, 1.0])
    whole = np.array([[_part_evidence(part, motion, float(x)) for x in around] for part in parts])
    delays = []
    share = JACKKNIFE_BLOCKS // len(parts)
    for number, part in enumerate(parts):
        for block in np.array_split(np.arange(len(part.times)), share):
            rest = _FlowPart(
                np.delete(part.components, block, axis=0), np.delete(part.times, block, axis=0)
            )
            reduced = np.array([_part_evidence(rest, motion, float(x)) for x in around])
            shift, bend = fit_profile_peak(*(whole.sum(axis=0) - whole[number] + reduced))
            delays.append(step * float(np.clip(shift, -2.0, 2.0)) if bend > 0.0 else step)
    return float(measure_jackknife_error(np.array(delays)))

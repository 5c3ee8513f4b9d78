"""Timing and play of an exploration log, by the likelihood of the body's own Gaussian process.

A track's curve y at t + τ − ρ r is a draw of the process at the link angles of t, with the delay τ
of its camera and ρ s more for a row r further down. Where J is the body's slope and s the place of
the links within half the play p, y − J s p has the process's mean m and, with noise, its covariance
K. So θ = (τ, ρ, p) is (AᵀK⁻¹A)⁻¹ AᵀK⁻¹(m − y) with the slopes A = (ẏ, −r ẏ, −J s), by Gauss–Newton.
Position and speed are interpolated from the same images, so their noise e, ė adds tr(K⁻¹ E[e ėᵀ])
and tr(K⁻¹ E[ė ėᵀ]) to the sums, which are subtracted. Residuals of the learned mean are a weaker
test: where paths hardly cross, the mean absorbs the delay. Errors of encoders that last are looked
for where play and row times are taken out (`lasting_likelihood`), and are part of K from then on.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..estimation.faults.threshold import EVIDENCE_THRESHOLD_NATS, SIGNIFICANT_SIGMA
from ..estimation.inference.filter_pass import MAX_SWEEPS, ROUGHLY_CONVERGED_MOVE
from ..estimation.measurements.arm_errors import (
    LEAST_PLAY,
    PLAY_STD,
    ArmErrors,
    RowExposure,
    read_slack,
)
from ..estimation.measurements.long_arrays import MIN_READINGS
from ..estimation.measurements.records import Encoders, Sighting
from ..estimation.measurements.track_curve import (
    BLUNDER_MEDIANS,
    MAX_CURVE_MEANS,
    Curve,
    build_track_curve,
    interpolate_curve,
)
from ..estimation.timing.delay_profile import MAX_DELAY_S, Delay
from ..types import Array
from .lasting_likelihood import (
    LEAST_RAD,
    TrackResiduals,
    lasting_covariance,
    measure_lasting_errors,
)

Prior = Callable[[Array], tuple[Array, Array]]
"""The prior of a track at angles (B,M) rad: mean (D,) and covariance (D,B,B), px or mm, squared."""
MOST_HALF = 0.05
"""rad: half of the largest play, 5.7°; more is no play."""
ROW_TIME_STD = 0.03
"""s: of a picture's row time; most pictures take less than 1/30 s."""
LASTING_MEANS = 400
"""Most means of all logs that errors which last are looked for with."""
LASTING_STEP_S = 0.1
"""s between them at least: a track longer than they reach gives its middle."""


@dataclass(frozen=True, eq=False)
class ExploredLog:
    """A log's motors, and each camera's tracks with their priors.

    encoders: with readings of the motors, not of the links.
    """

    encoders: Encoders
    tracks: Mapping[str, Sequence[tuple[Sighting, Prior]]]


@dataclass(frozen=True, eq=False)
class _PriorCurve:
    """A track's curve at B means in one log, and its prior's mean (D,) px and cov (D,B,B) px².

    share: of the camera's tracks, whose errors beside the same encoders correlate.
    """

    log: int
    camera: str
    curve: Curve
    mean: Array
    cov: Array
    share: float

    @property
    def has_rows(self) -> bool:
        """Whether it is in images, which are exposed row by row; points in space have none."""
        return len(self.mean) == 2

    @property
    def span(self) -> tuple[float, float]:
        """The rows (px) between which nearly all means are seen."""
        low, high = np.quantile(self.curve.predicted[:, -1], [0.01, 0.99])
        return float(low), float(high)


@dataclass(frozen=True, eq=False)
class _Evidence:
    """AᵀK⁻¹(y − m) (P,), AᵀK⁻¹A (P,P), and the prior standard deviations (P,)."""

    pull: Array
    weight: Array
    std: Array

    def nats_of(self, free: Array) -> float:
        """−ln p with these parameters free and all others 0, up to a constant."""
        prior = self.std[free]
        # scaled by their priors, so that units do not matter
        scaled = np.eye(len(free)) + prior[:, None] * self.weight[np.ix_(free, free)] * prior
        pull = prior * self.pull[free]
        logs = float(np.linalg.slogdet(scaled)[1])
        return 0.5 * (logs - float(pull @ np.linalg.solve(scaled, pull)))


class _Search:
    """The search for a delay of each log's cameras, a row time of
    each camera, and half a play of each joint, in this order.
    """

    def __init__(
        self, logs: Sequence[ExploredLog], joints: tuple[str, ...], known: ArmErrors
    ) -> None:
        self.logs = logs
        self.joints = joints
        lasting = [known.lasting.get(name, (0.0, 1.0)) for name in joints]
        self.lasting = np.array([std for std, _ in lasting])
        self.seconds = max((seconds for std, seconds in lasting if std), default=1.0)
        self.curves = [one for k, log in enumerate(logs) for one in _curves_of_log(k, log)]
        self.late = list(dict.fromkeys((one.log, one.camera) for one in self.curves))
        self.cameras = list(dict.fromkeys(one.camera for one in self.curves))
        widest = {one.camera: one.span for one in sorted(self.curves, key=_row_span)}
        self.middle = {name: 0.5 * sum(span) for name, span in widest.items()}
        self.span = {name: max(span[1] - span[0], 1.0) for name, span in widest.items()}
        first = len(self.late)
        imaging = {one.camera for one in self.curves if one.has_rows}
        self.rows = np.array(
            [first + k for k, name in enumerate(self.cameras) if name in imaging], int
        )
        self.play = np.arange(len(joints)) + first + len(self.cameras)
        self.std = np.concatenate(
            [
                np.full(first, MAX_DELAY_S),
                [ROW_TIME_STD / self.span[name] for name in self.cameras],
                np.full(len(joints), PLAY_STD),
            ]
        )

    def solve_with(self, free: Array) -> tuple[Array, Array, "_Evidence"]:
        """The sizes (P,) of the parameters that are free and of the delays, 0
        for others; their standard errors, and the evidence of some about them.
        """
        kept = np.concatenate([np.arange(len(self.late)), free])
        precision = np.diag(self.std[kept] ** -2.0)
        sizes = np.zeros(len(self.std))
        errors = np.zeros(len(self.std))
        for _ in range(MAX_SWEEPS):
            pull, weight = self._sum_up(sizes)
            evidence = _Evidence(pull - weight @ sizes, weight, self.std)
            cov = np.linalg.inv(weight[np.ix_(kept, kept)] + precision)
            step = cov @ (pull[kept] + precision @ sizes[kept])
            errors[kept] = np.sqrt(np.maximum(np.diag(cov), 1e-24))
            sizes[kept] -= step
            sizes[self.play] = np.clip(sizes[self.play], 0.0, MOST_HALF)
            if np.abs(step / errors[kept]).max() < ROUGHLY_CONVERGED_MOVE:
                break
        return sizes, errors, evidence

    def choose_errors(self) -> tuple[Array, Array, Array]:
        """What the evidence asks for beside delays, of row times
        and play; the sizes with these, and their standard errors.
        """
        none = np.zeros(0, int)
        both = np.concatenate([self.rows, self.play])
        sizes, errors, evidence = self.solve_with(both)
        delays = np.arange(len(self.late))

        def excess(some: Array, groups: int) -> float:
            nats = evidence.nats_of(np.concatenate([delays, some]))
            return nats + groups * EVIDENCE_THRESHOLD_NATS

        ways = [(none, 0), (self.rows, 1), (self.play, 1), (both, 2)]
        free, groups = min(ways, key=lambda way: excess(*way))
        if groups < 2:
            sizes, errors, _ = self.solve_with(free)
        return free, sizes, errors

    def _sum_up(self, sizes: Array) -> tuple[Array, Array]:
        """AᵀK⁻¹(y − J s p − m) (P,) and AᵀK⁻¹A (P,P) about these sizes."""
        pull = np.zeros(len(sizes))
        weight = np.zeros((len(sizes), len(sizes)))
        for one, own, aligned in self._align_curves(self.curves, sizes):
            pulled, weighed = _curve_sums(one, aligned, self.lasting, self.seconds)
            pull[own] += pulled * one.share
            weight[np.ix_(own, own)] += weighed * one.share
        return pull, weight

    def _align_curves(
        self, curves: Sequence[_PriorCurve], sizes: Array
    ) -> Iterator[tuple[_PriorCurve, Array, "_Aligned"]]:
        """Yield curves that are long enough where parameters of these
        sizes (P,) move them, with the numbers of their own parameters.
        """
        half = np.maximum(sizes[self.play], LEAST_PLAY)
        slacks = [read_slack(log.encoders.t, log.encoders.values, half) for log in self.logs]
        for one in curves:
            t = self.logs[one.log].encoders.t
            slack = np.column_stack([np.interp(one.curve.at, t, s) for s in slacks[one.log].T])
            own = np.array(
                [
                    self.late.index((one.log, one.camera)),
                    len(self.late) + self.cameras.index(one.camera),
                    *self.play,
                ]
            )
            rows = one.curve.predicted[:, -1] - self.middle[one.camera]
            rows = rows if one.has_rows else np.zeros(len(rows))
            aligned = _align_curve(one, rows, slack, sizes[own])
            if len(aligned.kept) >= MIN_READINGS:
                yield one, own, aligned

    def find_lasting(self, sizes: Array) -> dict[str, tuple[float, float]]:
        """Errors {joint: (rad, s)} of encoders that last, beside parameters of these sizes."""
        curves = [one for k, log in enumerate(self.logs) for one in _longest_curves(k, log)]
        curves = [one for one in curves if (one.log, one.camera) in self.late]
        parts = [
            _residuals_of_curve(one, aligned)
            for one, _, aligned in self._align_curves(curves, sizes)
        ]
        try:
            found = measure_lasting_errors(parts)
        except np.linalg.LinAlgError:
            return {}
        if found is None:
            return {}
        stds, seconds, _ = found
        return {
            name: (std, seconds)
            for name, std in zip(self.joints, stds.tolist(), strict=True)
            if std > LEAST_RAD
        }

    def name_errors(
        self, free: Array, sizes: Array, errors: Array
    ) -> tuple[list[dict[str, Delay]], ArmErrors]:
        """The delays by log, and what all logs share but errors that last."""
        delays: list[dict[str, Delay]] = [{} for _ in self.logs]
        for (log, name), size, error in zip(self.late, sizes, errors, strict=False):
            if abs(size) <= MAX_DELAY_S and error < 0.5 * MAX_DELAY_S:
                delays[log][name] = Delay(float(size), float(error))
        rows = {
            name: RowExposure(float(sizes[p]), float(errors[p]), self.middle[name], self.span[name])
            for p, name in enumerate(self.cameras, len(self.late))
            if p in free
        }
        play = {
            name: (2.0 * float(sizes[p]), 2.0 * float(errors[p]))
            for name, p in zip(self.joints, self.play, strict=True)
            if p in free and sizes[p] > SIGNIFICANT_SIGMA * errors[p]
        }
        return delays, ArmErrors(play, rows)


def measure_arm_errors(
    logs: Sequence[ExploredLog], joints: tuple[str, ...], known: ArmErrors
) -> tuple[list[dict[str, Delay]], ArmErrors]:
    """What is left of each camera's delay in each log, and the row times, play and errors
    that last which all logs share, as far as their evidence asks for them.

    known: the errors that the body was learned with. Errors that last are measured without new
    play and row times, as the body was learned: they take their place where these do not hold.
    """
    search = _Search(logs, joints, known)
    if not search.curves:
        return [{} for _ in logs], ArmErrors()
    free, sizes, errors = search.choose_errors()
    delays, found = search.name_errors(free, sizes, errors)
    as_learned = sizes if known.has_all_of(found) else np.zeros(len(sizes))
    return delays, replace(found, lasting=search.find_lasting(as_learned))


def _curves_of_log(number: int, log: ExploredLog) -> Iterator[_PriorCurve]:
    """Yield the curves of a log that are long enough."""
    for camera, tracks in log.tracks.items():
        found = [
            (curve, prior)
            for track, prior in tracks
            if (curve := build_track_curve(log.encoders, track, MAX_CURVE_MEANS // len(tracks)))
        ]
        for curve, prior in found:
            yield _PriorCurve(number, camera, curve, *prior(curve.x), 1.0 / len(found))


def _longest_curves(number: int, log: ExploredLog) -> Iterator[_PriorCurve]:
    """Yield the curve of each camera's longest track, or of its middle."""
    for camera, tracks in log.tracks.items():
        track, prior = max(tracks, key=lambda one: np.isfinite(one[0].values).all(axis=1).sum())
        most = max(LASTING_MEANS // len(log.tracks), 2 * MIN_READINGS)
        reach = 0.5 * most * LASTING_STEP_S
        middle = 0.5 * (track.t[0] + track.t[-1])
        part = track.select_span(max(middle - reach, track.t[0]), min(middle + reach, track.t[-1]))
        curve = build_track_curve(log.encoders, part, most)
        if curve:
            yield _PriorCurve(number, camera, curve, *prior(curve.x), 1.0)


def _row_span(one: _PriorCurve) -> float:
    """How many rows (px) a curve goes over."""
    low, high = one.span
    return high - low


@dataclass(frozen=True, eq=False)
class _Aligned:
    """A curve moved by its parameters: place, speed (B,2), loose (B,2,M): its slopes by half the
    plays; rows (B,) px from the middle. kept (R,): numbers of its means that are no blunders ·
    placed, moved (R,N): weights of the images in place and speed.
    """

    place: Array
    speed: Array
    loose: Array
    rows: Array
    kept: Array
    placed: Array
    moved: Array


def _align_curve(one: _PriorCurve, rows: Array, slack: Array, sizes: Array) -> _Aligned:
    """A curve moved by its delay, row time and plays of these sizes (C,).

    rows (B,) px from the middle · slack (B,M).
    """
    curve = one.curve
    place, speed, value, slope, first, sound = interpolate_curve(curve, sizes[0] - sizes[1] * rows)
    loose = curve.jac * slack[:, None]
    place = place - loose @ sizes[2:]
    off = np.linalg.norm(place - curve.predicted, axis=1)
    # positions far from the learned mean are blunders, too
    most = BLUNDER_MEDIANS * float(np.median(off[sound])) if sound.any() else 0.0
    kept = np.flatnonzero(sound & (off <= most))
    placed, moved = (
        _scatter_weights(part[kept], first[kept], len(curve.t)) for part in (value, slope)
    )
    return _Aligned(place, speed, loose, rows, kept, placed, moved)


def _curve_sums(
    one: _PriorCurve, aligned: _Aligned, lasting: Array, seconds: float
) -> tuple[Array, Array]:
    """AᵀK⁻¹(y − J s p − m) (C,) and AᵀK⁻¹A (C,C) of a curve, less their noise, for
    its delay, row time and plays.

    lasting (M,) rad, seconds: errors of encoders that the body is learned with.
    """
    curve = one.curve
    kept = aligned.kept
    pull = np.zeros(2 + len(lasting))
    weight = np.zeros((len(pull), len(pull)))
    noise = curve.noise + np.einsum("bdm,bm->bd", np.square(curve.jac[kept]), curve.encoder[kept])
    cross = aligned.moved @ aligned.placed.T
    own = aligned.moved @ aligned.moved.T
    timed = np.column_stack([np.ones(len(kept)), -aligned.rows[kept]])
    for d, prior in enumerate(one.cov):
        common = lasting_covariance(curve.jac[kept, d], curve.at[kept], lasting, seconds)
        known = prior[np.ix_(kept, kept)] + np.diag(noise[:, d]) + common
        inverse = np.linalg.inv(known)
        blur = curve.blur[d] / curve.images
        slopes = np.column_stack([aligned.speed[kept, d, None] * timed, -aligned.loose[kept, d]])
        residual = aligned.place[kept, d] - one.mean[d]
        lean = inverse @ slopes
        pull += lean.T @ residual
        weight += lean.T @ slopes
        pull[:2] -= blur * (timed.T @ (inverse * cross).sum(axis=1))
        weight[:2, :2] -= blur * (timed.T @ (inverse * own) @ timed)
    return pull, weight


def _residuals_of_curve(one: _PriorCurve, aligned: _Aligned) -> TrackResiduals:
    """A curve's residuals as rows: all means of the first output, then of the next."""
    curve = one.curve
    kept = aligned.kept
    count = len(kept)
    outputs = len(one.mean)
    prior = np.zeros((outputs, count, outputs, count))
    noise = np.zeros(prior.shape)
    near = aligned.placed @ aligned.placed.T / curve.images
    for d in range(outputs):
        read = (np.square(curve.jac[kept, d]) * curve.encoder[kept]).sum(axis=1)
        prior[d, :, d] = one.cov[d][np.ix_(kept, kept)] + np.diag(read)
        noise[d, :, d] = curve.noise[d] * near
    size = outputs * count
    return TrackResiduals(
        (aligned.place[kept] - one.mean).T.ravel(),
        prior.reshape(size, size),
        noise.reshape(size, size),
        curve.jac[kept].swapaxes(0, 1).reshape(size, -1),
        np.tile(curve.at[kept], outputs),
    )


def _scatter_weights(weights: Array, first: Array, count: int) -> Array:
    """Weights (B,4) of the four images from `first` (B,) on as a matrix (B,count)."""
    found = np.zeros((len(weights), count))
    found[np.arange(len(weights))[:, None], first[:, None] + np.arange(4)] = weights
    return found

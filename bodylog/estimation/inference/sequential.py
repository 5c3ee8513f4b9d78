"""The filter one instant after the other, for a log and beside a robot, by the kernel that filters
whole logs (kernels.py). The tracks of an instant are linearised until the belief converges.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...types import Array
from ..noise.correlated_noise import LastFrame, PendingFrame
from ..noise.posture_prior import PosturePrior
from .filter_pass import (
    CONVERGED_MOVE,
    GATE_SIGMA,
    MAX_SWEEPS,
    FilterDynamics,
    FilterReadings,
    allocate_trace,
    prepare_filter,
)
from .reacquisition import LONG_SILENCE_S, find_lost_joints, find_open_joints
from .tangents import build_state_prior


class Line(NamedTuple):
    """A track linearised to D rows: y (D,) = jac (D,M) x with independent variances var (D,).

    memory: of the track.
    """

    jac: Array
    y: Array
    var: Array
    memory: LastFrame


class SteppedBelief(NamedTuple):
    """The belief z (K,), p (K,K) after an instant, and x
    (M,) rad, cov (M,M) of the angles before its readings.

    d (M,): innovations of the encoders, in standard
    deviations, NaN where silent · nats of all readings.
    """

    z: Array
    p: Array
    x: Array
    cov: Array
    d: Array
    nats: float


class FilterStep:
    """The belief from an instant to the next, by the
    encoders and by lines of T tracks with up to D rows.
    """

    def __init__(self, dynamics: FilterDynamics, tracks: int = 0, rows: int = 0) -> None:
        """Dynamics with process (M,). All arrays stay
        where they are, so that a call only fills them.
        """
        m = len(dynamics.process)
        k = dynamics.size
        n = k // m
        self._dynamics = dynamics
        self._z = np.empty(k)
        self._p = np.empty((k, k))
        self._reset = np.empty((1, m), bool)
        self._process_factor = np.empty((1, m))
        self._moves = (np.empty((1, n, n, m)), np.empty((1, n, m)), np.empty((1, n, n, m)))
        self._readings = FilterReadings(
            np.empty(1),
            np.empty((1, m)),
            np.empty((1, m)),
            np.empty((1, tracks, rows)),
            np.empty((1, tracks, rows, m)),
            np.empty((1, tracks, rows)),
            reset=self._reset,
            process_factor=self._process_factor,
            moves=self._moves,
        )
        self._trace = allocate_trace(self._readings, dynamics)
        self._run = prepare_filter(self._readings, dynamics, self._z, self._p, self._trace)

    def __call__(
        self,
        z: Array,
        p: Array,
        dt: float,
        encoders: Sequence[float] | Array,
        var: Sequence[float] | Array,
        lines: Sequence[Line] = (),
        *,
        lost: Array | None = None,
        held: Array | None = None,
        process_factor: Array | None = None,
    ) -> SteppedBelief:
        """The belief dt (s) after z (K,), p (K,K), given readings
        (M) rad, NaN where silent, with variances var (M).

        lines: one for each track · lost (M,) bool: joints that restart · held (M,) bool: joints
        silent for long · process_factor (M,): on the process variance. LinAlgError where rounding
        leaves no number.
        """
        readings = self._readings
        self._z[:] = z
        self._p[:] = p
        readings.dt[0] = dt
        readings.encoders[0] = encoders
        readings.encoder_var[0] = var
        self._reset[0] = False if lost is None else lost
        self._process_factor[0] = 1.0 if process_factor is None else process_factor
        self._write_moves(dt, held)
        if lines:
            readings.y[:] = np.nan
            readings.jac[:] = 0.0
            readings.var[:] = 1.0
        for track, line in enumerate(lines):
            n = len(line.y)
            readings.y[0, track, :n] = line.y
            readings.jac[0, track, :n] = line.jac
            readings.var[0, track, :n] = line.var
        self._run()
        trace = self._trace
        nats = trace.nats.item()
        if not math.isfinite(nats):
            raise np.linalg.LinAlgError("rounding leaves no number")
        return SteppedBelief(
            trace.z[0].copy(),
            trace.end_p.copy(),
            trace.prior[0].copy(),
            trace.prior_cov[0].copy(),
            trace.encoder_d[0].copy(),
            nats,
        )

    def _write_moves(self, dt: float, held: Array | None) -> None:
        """Write the moves of joints held (M,) within dt, and of a model that the kernel lacks."""
        self._moves[0].fill(np.nan)
        if held is not None and self._dynamics.stationary is not None:
            silent = self._dynamics.compute_silent_moves(np.array([dt]), held[None])
            for part, own in zip(self._moves, silent, strict=True):
                part[:] = own
        moved = self._dynamics.add_model_moves(self._readings)
        if moved is not self._readings:
            for part, own in zip(self._moves, moved.moves or (), strict=True):
                part[:] = own


NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
"""Gauss and Hermite's rule, exact to the ninth power along each axis of a belief."""
WEIGHTS /= WEIGHTS.sum()
PERSISTENCE = 10.0
"""Factor on the time for which the residual of a line lasts, by the belief.

Of 1, 3.3, 10 and 33 on 26 drawn silences of 5 s, filters
have NEES 7.5, 3.4, 1.6, 1.6 and errors of 0.20, 0.18, 0.18,
0.19 rad.
"""


def _count_numbers_in_view(t: float, seen: Mapping[Any, PendingFrame]) -> int:
    """The numbers that images gave shortly before t (s)."""
    return sum(len(frame.value) for frame in seen.values() if t - frame.t <= LONG_SILENCE_S)


def standardise_innovations(x: Array, cov: Array, sights: Sequence[PendingFrame]) -> list[Array]:
    """Innovations (D,) of each track in standard deviations,
    by angles x (M,) of cov (M,M) before the instant.
    """
    found = []
    for sight in sights:
        mean, jac, model = sight.predict_single(x)
        var = ((jac @ cov) * jac).sum(axis=1) + sight.var + model
        found.append((sight.value - mean) / np.sqrt(var))
    return found


def find_tangent_point(
    x: Array, sights: Sequence[PendingFrame], step: Callable[..., SteppedBelief], resting: float
) -> tuple[Array, list[Line], SteppedBelief]:
    """The point (M,) where the belief converges to `resting`
    rad, or moves least, the tracks' tangents there, and the belief by these.

    The search starts at the angles x (M,) before the instant;
    `step` gives the belief by all encoder readings and lines.
    """
    taken = np.zeros(len(x))
    last = taken
    least = math.inf
    best = None
    for _ in range(MAX_SWEEPS):
        lines = [_linearise_frame(sight, x) for sight in sights]
        belief = step(lines=lines)
        move = belief.z[: len(x)] - x
        size = max(map(abs, move.tolist()))
        if best is None or not size >= least:
            least = size
            best = (x, lines, belief)
        if size < resting:
            break
        taken = _accelerate_step(move, last, taken)
        last = move
        x = x + taken
    assert best is not None  # there is at least one round
    return best


def _linearise_frame(sight: PendingFrame, x: Array) -> Line:
    """The tangent of a frame at angles x (M,)."""
    mean, jac, _, var, memory = sight.predict_inflated(x)
    return Line(jac, sight.value - mean + jac @ x, var, memory)


def _accelerate_step(move: Array, last: Array, taken: Array) -> Array:
    """Next step (M,) from Gauss–Newton's `move`, the
    `last` one and the step taken then: Anderson mixing.
    """
    turn = move - last
    size = turn @ turn
    if size == 0.0 or not taken.any():
        return move
    return np.asarray(move - (turn @ move / size) * (taken + turn))


def fit_statistical_lines(m: int, z: Array, p: Array, sights: Sequence[PendingFrame]) -> list[Line]:
    """Lines of least squared residual over the encoders'
    posterior of M angles: state z (K,), covariance p (K,K).

    The residual is a function of the belief's error, which lasts: with a Gaussian correlation over
    √(variance of the angle / of the rate), it counts √π of that, over the time between frames, as
    often; PERSISTENCE times more, as a wrong belief takes itself for a short one.
    """
    var, axes = _decompose_covariance(p[:m, :m])
    rates = p[m : 2 * m, m : 2 * m]
    if not np.trace(rates) > 0.0:
        raise np.linalg.LinAlgError(f"rates have the variance {np.trace(rates):.3g} rad²/s²")
    # above rounding, which a rate known exactly may take below 0
    rate = max(axes[:, -1] @ rates @ axes[:, -1], np.finfo(float).eps * np.trace(rates))
    lasts = PERSISTENCE * math.sqrt(math.pi * var[-1] / rate)
    counts = [1.0 / math.tanh((sight.t - sight.memory.t) / lasts) for sight in sights]
    return [
        linearise_over_belief(sight, z[:m], p[:m, :m], count)
        for sight, count in zip(sights, counts, strict=True)
    ]


def _decompose_covariance(cov: Array) -> tuple[Array, Array]:
    """Variances (M,) along the axes (M,M), in columns, of a covariance; above 0."""
    var, axes = np.linalg.eigh(cov)
    return np.maximum(var, np.finfo(float).tiny), axes


def linearise_over_belief(sight: PendingFrame, x: Array, cov: Array, count: float = 1.0) -> Line:
    """A track's line over a belief x (M,) of cov (M,M).

    The residual is added as noise, as the tangent of a wide belief claims too much: along each axis
    of cov, by Gauss–Hermite quadrature, `count` times. Rows are rotated such that their noise is
    independent.
    """
    *_, own, memory = sight.predict_inflated(x)
    var, axes = _decompose_covariance(cov)
    steps = np.sqrt(var)[:, None] * axes.T
    points = x + NODES[:, None, None] * steps
    g = sight.predict(points.reshape(-1, len(x)))[0].reshape(len(NODES), len(x), -1)
    means, slopes = (np.einsum("k,kad->ad", weights, g) for weights in (WEIGHTS, WEIGHTS * NODES))
    missed = np.sqrt(WEIGHTS)[:, None, None] * (g - means - NODES[:, None, None] * slopes)
    slope = np.linalg.solve(steps, slopes).T
    middle = g[len(NODES) // 2, 0]
    middle = middle + (means - middle).sum(axis=0)
    spread, turn = np.linalg.eigh(count * np.einsum("kad,kae->de", missed, missed) + np.diag(own))
    return Line(turn.T @ slope, turn.T @ (sight.value - middle + slope @ x), spread, memory)


@dataclass(eq=False, slots=True)
class State:
    """After an instant t (s; −∞ before the first): belief z (K,), p (K,K).

    confirmed_t, read_t (M) s: times at which each encoder last confirmed the belief, and was last
    read, −∞ for never · seen: last frame of each track. Of this instant: nats · encoder_d (M) and
    errors of tracks, in standard deviations · lost (M,) bool: joints re-initialised · held (M,)
    bool: joints silent for long before it · point (M,) rad of its tangents · lines: the tracks'
    lines if images left joints open.
    """

    t: float
    z: Array
    p: Array
    confirmed_t: Sequence[float]
    read_t: Sequence[float]
    seen: Mapping[Any, PendingFrame] = field(default_factory=dict)
    nats: float = 0.0
    encoder_d: Sequence[float] = ()
    lost: Array | None = None
    held: Array | None = None
    errors: Mapping[Any, Array] = field(default_factory=dict)
    point: Array | None = None
    lines: Mapping[Any, Line] | None = None


class SequentialFilter:
    """The filter from an instant to the next, with frames
    linearised until their point moves less than `rest` (rad).
    """

    def __init__(
        self, dynamics: FilterDynamics, posture: PosturePrior | None, rest: float = CONVERGED_MOVE
    ) -> None:
        """Dynamics, and the posture prior of joints without an encoder."""
        self._dynamics = dynamics
        self._posture = posture
        self._never_read = 0 if posture is None else int(posture.joints.sum())
        self._rest = rest
        self._steps = dict[tuple[int, int], FilterStep]()

    def build_first_state(self, start: Array) -> State:
        """The state before any measurement, at the angles `start` (M,) rad."""
        never = [-math.inf] * len(start)
        return State(-math.inf, *build_state_prior(start, self._dynamics), never, never)

    def filter_instant(
        self,
        before: State,
        t: float,
        readings: Sequence[float] | Array,
        var: Sequence[float] | Array,
        frames: Mapping[Any, PendingFrame],
        process_factor: Array | None = None,
    ) -> State:
        """The state after readings (M) rad, NaN where silent,
        with variances var, and frames of tracks at t (s).

        process_factor (M,): on the process variance.
        """
        dt = t - before.t if before.t > -math.inf else 0.0
        confirmed_t = before.confirmed_t
        step = partial(self._step_belief, before.z, before.p, dt, process_factor=process_factor)
        held = None
        numbers = 0
        lost = None
        read = [not math.isnan(reading) for reading in readings]
        confirmed: Iterable[bool] = read
        if not t - min(confirmed_t) <= LONG_SILENCE_S:
            ages = t - np.array(confirmed_t)
            numbers = _count_numbers_in_view(t, before.seen)
            left_open = find_open_joints(ages, numbers)
            held = left_open if left_open.any() else None
            prior = step([math.nan] * len(confirmed_t), var, held=held)
            lost, confirmed = find_lost_joints(
                t,
                ages,
                prior.z,
                prior.p,
                np.array(readings),
                np.array(var),
                before.seen,
                bool(frames),
                self._dynamics.order,
            )
        if self._posture is not None and dt > 0.0:
            readings, var = self._posture.add_pseudo_readings(np.array(readings), np.array(var), dt)
        step = partial(step, readings, var, lost=lost, held=held)
        read_t = [t if now else last for now, last in zip(read, before.read_t, strict=True)]
        after = State(t, before.z, before.p, [], read_t, before.seen, lost=lost, held=held)
        belief = step()
        if frames:
            in_view = _count_numbers_in_view(t, {**before.seen, **frames})
            open_silence = numbers > 0 and held is not None
            adrift = open_silence or in_view <= self._never_read
            belief = self._filter_frames(after, belief, frames, step, adrift)
        after.z = belief.z
        after.p = belief.p
        after.nats = belief.nats
        after.encoder_d = belief.d.tolist()
        # an outlier confirms nothing: a belief that rejects
        # an encoder for long is in doubt as after its silence
        after.confirmed_t = [
            t if sure and not abs(d) > GATE_SIGMA else last
            for sure, d, last in zip(confirmed, after.encoder_d, confirmed_t, strict=True)
        ]
        return after

    def _step_belief(
        self,
        z: Array,
        p: Array,
        dt: float,
        readings: Sequence[float] | Array,
        var: Sequence[float] | Array,
        lines: Sequence[Line] = (),
        **joints: Array | None,
    ) -> SteppedBelief:
        """The belief dt (s) later, by a `FilterStep` with room for the lines."""
        shape = (len(lines), max((len(line.y) for line in lines), default=0))
        if shape not in self._steps:
            self._steps[shape] = FilterStep(self._dynamics, *shape)
        return self._steps[shape](z, p, dt, readings, var, lines, **joints)

    def _filter_frames(
        self,
        after: State,
        encoded: SteppedBelief,
        frames: Mapping[Any, PendingFrame],
        step: Callable[..., SteppedBelief],
        adrift: bool,
    ) -> SteppedBelief:
        """The belief by frames too, noted in the state;
        adrift: along statistical lines, not tangents.

        encoded: the belief by the encoders alone · step: gives the one by lines too.
        """
        m = len(encoded.x)
        seen = after.seen
        sights = [
            replace(f, memory=seen[track].memory) if track in seen else f
            for track, f in frames.items()
        ]
        after.errors = dict(
            zip(frames, standardise_innovations(encoded.x, encoded.cov, sights), strict=True)
        )
        if adrift:
            after.point = encoded.z[:m]
            lines = fit_statistical_lines(m, encoded.z, encoded.p, sights)
            after.lines = dict(zip(frames, lines, strict=True))
            belief = step(lines=lines)
        else:
            after.point, lines, belief = find_tangent_point(encoded.x, sights, step, self._rest)
        memories = (
            replace(sight, memory=line.memory) for sight, line in zip(sights, lines, strict=True)
        )
        after.seen = {**seen, **dict(zip(frames, memories, strict=True))}
        return belief

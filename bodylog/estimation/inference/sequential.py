"""The filter one instant after the other: one step, for a log and beside a robot.

One instant of the filter, by the kernel that filters whole logs (kernels.py).

Tracks of one instant, linearised until the belief converges.
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
from .reacquisition import LONG_SILENCE_S, find_lost_joints, open_joints
from .scan import (
    CONVERGED_MOVE,
    GATE_SIGMA,
    MAX_SWEEPS,
    FilterDynamics,
    FilterReadings,
    allocate_trace,
    prepare_filter,
)
from .tangents import state_prior


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
        self._dynamics, self._z, self._p = dynamics, np.empty((k, 1)), np.empty((k, k, 1))
        self._leaps = np.empty((1, n, n, m, 1)), np.empty((1, n, m, 1)), np.empty((1, n, n, m, 1))
        self._lost, self._more = np.empty((1, m, 1), bool), np.empty((1, m, 1))
        self._readings = FilterReadings(
            np.empty((1, 1)),
            np.empty((1, m, 1)),
            np.empty((1, m, 1)),
            np.empty((1, tracks, rows, 1)),
            np.empty((1, tracks, rows, m, 1)),
            np.empty((1, tracks, rows, 1)),
            reset=self._lost,
            more=self._more,
            moves=self._leaps,
        )
        to = self._readings
        trace = self._trace = allocate_trace(to, dynamics, 1)
        self._run = prepare_filter(to, dynamics, self._z, self._p, trace)
        read = to.encoders[0], to.encoder_var[0], self._lost[0], self._more[0]
        made = trace.z[0], trace.end_p, trace.prior[0], trace.prior_cov[0], trace.encoder_d[0]
        self._before = [part[..., 0] for part in (self._z, self._p, to.dt, *read)]
        self._after = [part[..., 0] for part in made]

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
        more: Array | None = None,
    ) -> SteppedBelief:
        """The belief dt (s) after z (K,), p (K,K), given readings
        (M) rad, NaN where silent, with variances var (M).

        lines: one for each track · lost (M,) bool: joints that restart ·
        held (M,) bool: joints silent for long · more (M,): factor on the
        process variance. LinAlgError where rounding leaves no number.
        """
        to = self._readings
        once = False if lost is None else lost, 1.0 if more is None else more
        for part, given in zip(self._before, (z, p, dt, encoders, var, *once), strict=True):
            part[:] = given
        self._leaps[0].fill(np.nan)
        if held is not None and self._dynamics.stationary is not None:
            for part, found in zip(
                self._leaps, self._dynamics.silent_moves(np.array([dt]), held[None]), strict=True
            ):
                part[..., 0] = found
        if (moved := self._dynamics.with_moves(to)) is not to:
            for part, found in zip(self._leaps, moved.moves or (), strict=True):
                part[:] = found
        if lines:
            to.y[:], to.jac[:], to.var[:] = np.nan, 0.0, 1.0
        for track, line in enumerate(lines):
            n = len(line.y)
            to.y[0, track, :n, 0], to.jac[0, track, :n, :, 0], to.var[0, track, :n, 0] = (
                line.y,
                line.jac,
                line.var,
            )
        self._run()
        if not math.isfinite(nats := self._trace.nats.item()):
            raise np.linalg.LinAlgError("rounding leaves no number")
        z, p, x, cov, d = (part.copy() for part in self._after)
        return SteppedBelief(z, p, x, cov, d, nats)


NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
WEIGHTS /= WEIGHTS.sum()
"""Gauss and Hermite's rule, exact to the ninth power along each axis of a belief."""
PERSISTENCE = 10.0
"""Factor on the time for which the residual of a line lasts, by the belief.

Of 1, 3.3, 10 and 33 on 26 drawn silences of 5 s, filters
have NEES 7.5, 3.4, 1.6, 1.6 and errors of 0.20, 0.18, 0.18,
0.19 rad.
"""


def standardise_innovations(x: Array, cov: Array, sights: Sequence[PendingFrame]) -> list[Array]:
    """Innovations (D,) of each track in standard deviations,
    by angles x (M,) of cov (M,M) before the instant.
    """
    found = []
    for sight in sights:
        mean, jac, model = sight.predict_single(x)
        found.append(
            (sight.value - mean) / np.sqrt(((jac @ cov) * jac).sum(axis=1) + sight.var + model)
        )
    return found


def find_tangent_point(
    x: Array, sights: Sequence[PendingFrame], given: Callable[..., SteppedBelief], resting: float
) -> tuple[Array, list[Line], SteppedBelief]:
    """The point (M,) where the belief converges to `resting`
    rad, or moves least, the tracks' tangents there, and the belief by these.

    The search starts at the angles x (M,) before the instant;
    `given` is the belief by all readings and lines.
    """
    went = last = np.zeros(len(x))
    least = math.inf
    best = None
    for _ in range(MAX_SWEEPS):
        lines = [_linearise_frame(sight, x) for sight in sights]
        belief = given(lines=lines)
        move = belief.z[: len(x)] - x
        size = max(map(abs, move.tolist()))
        if best is None or not size >= least:
            least = size
            best = (x, lines, belief)
        if size < resting:
            break
        went = _accelerate_step(move, last, went)
        last = move
        x = x + went
    assert best is not None  # there is at least one round
    return best


def _linearise_frame(sight: PendingFrame, x: Array) -> Line:
    mean, jac, _, var, memory = sight.predict_inflated(x)
    return Line(jac, sight.value - mean + jac @ x, var, memory)


def _accelerate_step(move: Array, last: Array, went: Array) -> Array:
    """Next step (M,) from Gauss–Newton's `move`, the
    `last` one and the step taken then: Anderson mixing.
    """
    turn = move - last
    size = turn @ turn
    return move if size == 0.0 or not went.any() else move - (turn @ move / size) * (went + turn)


def statistical_lines(m: int, z: Array, p: Array, sights: Sequence[PendingFrame]) -> list[Line]:
    """Lines of least squared residual over the encoders'
    posterior of M angles: state z (K,), covariance p (K,K).

    The residual is a function of the belief's error, which lasts: with a Gaussian correlation over
    √(variance of the angle / of the rate), it counts √π of that, over the time between frames, as
    often; PERSISTENCE times more, as a wrong belief takes itself for a short one.
    """
    (var, axes), rates = _decompose_covariance(p[:m, :m]), p[m : 2 * m, m : 2 * m]
    if not np.trace(rates) > 0.0:
        raise np.linalg.LinAlgError(f"rates have the variance {np.trace(rates):.3g} rad²/s²")
    # above rounding, which a rate known exactly may take below 0
    rate = max(axes[:, -1] @ rates @ axes[:, -1], np.finfo(float).eps * np.trace(rates))
    lasts = PERSISTENCE * math.sqrt(math.pi * var[-1] / rate)
    often = [1.0 / math.tanh((sight.t - sight.memory.t) / lasts) for sight in sights]
    return [
        linearise_over_belief(sight, z[:m], p[:m, :m], one)
        for sight, one in zip(sights, often, strict=True)
    ]


def _decompose_covariance(cov: Array) -> tuple[Array, Array]:
    """Variances (M,) along the axes (M,M), in columns, of a covariance; above 0."""
    var, axes = np.linalg.eigh(cov)
    return np.maximum(var, np.finfo(float).tiny), axes


def linearise_over_belief(sight: PendingFrame, x: Array, cov: Array, often: float = 1.0) -> Line:
    """A track's line over a belief x (M,) of cov (M,M).

    The residual is added as noise, as the tangent of a wide belief claims
    too much: along each axis of cov, by Gauss–Hermite quadrature, counted
    as `often`. Rows are rotated such that their noise is independent.
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
    spread, turn = np.linalg.eigh(often * np.einsum("kad,kae->de", missed, missed) + np.diag(own))
    return Line(turn.T @ slope, turn.T @ (sight.value - middle + slope @ x), spread, memory)


@dataclass(eq=False, slots=True)
class State:
    """After an instant t (s; −∞ before the first): belief z (K,), p (K,K).

    borne (M) s: time at which each encoder last confirmed the belief, −∞ for never ·
    seen: last frame of each track. Of this instant: nats · encoder_d (M) and errors of
    tracks, in standard deviations · lost (M,) bool: joints re-initialised · held (M,)
    bool: joints silent for long before it · point (M,) rad of its tangents · lines: the
    tracks' lines if held joints were hardly determined.
    """

    t: float
    z: Array
    p: Array
    borne: Sequence[float]
    seen: Mapping[Any, PendingFrame] = field(default_factory=dict)
    nats: float = 0.0
    encoder_d: Sequence[float] = ()
    lost: Array | None = None
    held: Array | None = None
    errors: Mapping[Any, Array] = field(default_factory=dict)
    point: Array | None = None
    lines: Mapping[Any, Line] | None = None


class SequentialFilter:
    """Steps from an instant to the next, with frames
    linearised until their point moves less than `rest` (rad).
    """

    def __init__(
        self, dynamics: FilterDynamics, posture: PosturePrior | None, rest: float = CONVERGED_MOVE
    ) -> None:
        """Dynamics, and the posture prior of joints without an encoder."""
        self._dynamics = dynamics
        self._posture = posture
        self._rest = rest
        self._steps = dict[tuple[int, int], FilterStep]()

    def first(self, start: Array) -> State:
        """The state before any measurement, at the angles `start` (M,) rad."""
        return State(-math.inf, *state_prior(start, self._dynamics), [-math.inf] * len(start))

    def step(
        self,
        before: State,
        t: float,
        readings: Sequence[float] | Array,
        var: Sequence[float] | Array,
        frames: Mapping[Any, PendingFrame],
        more: Array | None = None,
    ) -> State:
        """The state after readings (M) rad, NaN where silent,
        with variances var, and frames of tracks at t (s).

        more (M,): factor on the process variance.
        """
        dt = t - before.t if before.t > -math.inf else 0.0
        borne = before.borne
        moved = partial(self._stepped, before.z, before.p, dt, more=more)
        held = None
        numbers = 0
        lost = None
        confirmed: Iterable[bool] = [reading == reading for reading in readings]
        if not t - min(borne) <= LONG_SILENCE_S:
            ages = t - np.array(borne)
            numbers = sum(
                len(frame.value) for frame in before.seen.values() if t - frame.t <= LONG_SILENCE_S
            )
            held = found if (found := open_joints(ages, numbers)).any() else None
            prior = moved([math.nan] * len(borne), var, held=held)
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
        given = partial(moved, readings, var, lost=lost, held=held)
        after = State(t, before.z, before.p, [], before.seen, lost=lost, held=held)
        belief = given()
        if frames:
            belief = self._see(after, belief, frames, given, numbers > 0 and held is not None)
        after.z, after.p, after.nats, after.encoder_d = (
            belief.z,
            belief.p,
            belief.nats,
            belief.d.tolist(),
        )
        # an outlier confirms nothing: a belief that rejects
        # an encoder for long is in doubt as after its silence
        sound = (
            sure and not abs(x) > GATE_SIGMA
            for sure, x in zip(confirmed, after.encoder_d, strict=True)
        )
        after.borne = [t if sure else last for sure, last in zip(sound, borne, strict=True)]
        return after

    def _stepped(
        self,
        z: Array,
        p: Array,
        dt: float,
        readings: Sequence[float] | Array,
        var: Sequence[float] | Array,
        lines: Sequence[Line] = (),
        **joints: Array | None,
    ) -> SteppedBelief:
        shape = len(lines), max((len(line.y) for line in lines), default=0)
        if shape not in self._steps:
            self._steps[shape] = FilterStep(self._dynamics, *shape)
        return self._steps[shape](z, p, dt, readings, var, lines, **joints)

    def _see(
        self,
        after: State,
        encoded: SteppedBelief,
        frames: Mapping[Any, PendingFrame],
        given: Callable[..., SteppedBelief],
        adrift: bool,
    ) -> SteppedBelief:
        """The belief by frames too, noted in the state;
        adrift: along statistical lines, not tangents.

        encoded: the belief by the encoders alone · given: the one by lines too.
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
            after.point, lines = encoded.z[:m], statistical_lines(m, encoded.z, encoded.p, sights)
            after.lines = dict(zip(frames, lines, strict=True))
            belief = given(lines=lines)
        else:
            after.point, lines, belief = find_tangent_point(encoded.x, sights, given, self._rest)
        memories = (
            replace(sight, memory=line.memory) for sight, line in zip(sights, lines, strict=True)
        )
        after.seen = {**seen, **dict(zip(frames, memories, strict=True))}
        return belief

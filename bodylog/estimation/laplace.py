"""The generalised free-energy filter: belief over angles and rates, Gauss–Newton to convergence at every instant.

Under the Laplace approximation that is an iterated extended Kalman filter. All frames are linearised at once, all
stretches of the log are filtered side by side from the ends of their predecessors, and this is repeated until neither
the points of linearisation nor the starts move: the fixed point is the sequential filter's own.
"""

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from ..types import Array
from .folds import Fold, fold_for
from .instant import ALIKE
from .precision import Precision
from .scan import Dynamics, Readings, Trace, scan
from .senses import Evidence
from .timeline import Timeline

START_STD = 1.0
"""rad and rad/s: how little is known of angles and rates before the first reading."""
OFFSET_STD = 0.01
"""rad: how far an encoder that is allowed an offset may be off before the first reading."""
SWEEPS = 40
SETTLED = 1e-7
"""Standard deviations: how little a stretch's start may still move."""
RESTING = 1e-8
"""rad: a frame whose point of linearisation is moved less keeps its tangent."""


@dataclass(frozen=True, eq=False)
class Problem:
    """One log to be filtered: evidence, its instants, where the belief starts, the precisions.

    path: times (E,) s and angles (E,M) rad to linearise along first, where the encoders do not say.
    """

    evidence: Evidence
    timeline: Timeline
    start: Array
    precision: Precision
    path: tuple[Array, Array] | None = None

    @property
    def dynamics(self) -> Dynamics:
        """How the state moves."""
        return Dynamics(self.precision.process, self.precision.drift)


@dataclass(frozen=True, eq=False)
class Solution:
    """A filtered log: fold, its readings as last linearised, their points (F,M) per sighting, trace."""

    fold: Fold
    readings: Readings
    points: tuple[Array, ...]
    trace: Trace


def prior(problem: Problem) -> tuple[Array, Array]:
    """State z (K,) and covariance p (K,K) before anything is heard."""
    m, drift = len(problem.start), problem.precision.drift
    z = np.concatenate([problem.start, np.zeros(problem.dynamics.size - m)])
    var = np.full(len(z), START_STD**2)
    if drift is not None:
        var[2 * m :] = np.where(drift > 0, OFFSET_STD**2, 0.0)
    return z, np.diag(var)


def solve(
    problem: Problem, warm: Solution | None = None, at: str = "posterior", rest: float = SETTLED
) -> Solution:
    """The sequential filter's fixed point; frames are linearised at the `posterior` (iterated) or the `prior` mean.

    `warm` is a solution of the same log to begin from; `rest` says how still starts (in std) must be to be done.
    """
    fold, line = fold_for(len(problem.timeline.t)), problem.timeline
    readings, (z, p) = heard(problem, fold), starts(problem, fold, warm)
    tangents = Tangents(guesses(problem) if warm is None else warm.points, RESTING * rest / SETTLED)
    trace = None
    for _ in range(SWEEPS):
        tangents.draw(problem, fold, readings)
        trace = scan(readings, problem.dynamics, z, p, into=trace)
        means = trace.prior if at == "prior" else trace.z
        moved = tangents.follow(tuple(fold.pick(means, events)[:, : len(problem.start)] for events in line.sightings))
        next_z, next_p = handed_over(z, p, trace, fold)
        move, z, p = far(z, p, next_z, next_p), next_z, next_p
        if move < rest and not moved:
            return Solution(fold, readings, tangents.points, trace)
    raise Restless(f"laplace: no rest after {SWEEPS} sweeps, last move {move:.2g}")


class Restless(Exception):
    """Sweeps over the log did not come to rest: the caller goes through it one instant after the other."""


class Tangents:
    """Where each sighting's frames are linearised, (F,M) rad each; frames that rest are not predicted anew."""

    def __init__(self, points: tuple[Array, ...], resting: float = RESTING) -> None:
        """Start from points (F,M), all to be drawn; moves below `resting` rad are not followed."""
        self._resting = resting
        self.points = points
        self._stale = tuple(np.ones(len(x), bool) for x in points)
        self._model_var = tuple(np.zeros((len(x), 2)) for x in points)

    def draw(self, problem: Problem, fold: Fold, readings: Readings) -> None:
        """Write every stale frame's tangent into the readings: y = s − g + J x°, var = pixel + n² model variance."""
        triples = zip(problem.evidence.sightings, problem.timeline.sightings, self.points, self._stale, strict=True)
        for index, (sighting, events, points, stale) in enumerate(triples):
            if not stale.any():
                continue
            x, events = points[stale], events[stale]
            mean, jac, self._model_var[index][stale] = sighting.model.predict(x)
            scale = problem.precision.scale.get(sighting.name, 1.0)
            seen = np.isfinite(sighting.values).all(axis=1)
            var = self._model_var[index].copy()
            var[seen] *= repeats(points[seen])[:, None] ** 2
            fold.put(readings.y[:, index], events, sighting.values[stale] - mean + np.einsum("fdm,fm->fd", jac, x))
            fold.put(readings.jac[:, index], events, jac)
            fold.put(readings.var[:, index], problem.timeline.sightings[index], scale * sighting.var + var)

    def follow(self, wanted: tuple[Array, ...]) -> bool:
        """Move to the wanted points where they are further away than rest allows; whether any moved."""
        pairs = list(zip(wanted, self.points, strict=True))
        self._stale = tuple(np.abs(new - old).max(axis=1) > self._resting for new, old in pairs)
        self.points = tuple(
            np.where(stale[:, None], new, old) for stale, (new, old) in zip(self._stale, pairs, strict=True)
        )
        return any(bool(stale.any()) for stale in self._stale)


def repeats(points: Array) -> Array:
    """How many frames (F,) up to each were taken from nearly the same angles (F,M): there the model errs alike.

    With n² times its variance in the n-th of them, standing still before the camera never teaches more than the model
    knows: the information adds up to less than 1.65 / variance, not to frames / variance.
    """
    if not len(points):
        return np.empty(0)
    apart = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.array(list(accumulate(np.exp(-apart / ALIKE).tolist(), lambda n, kept: 1.0 + kept * n, initial=1.0)))


def heard(problem: Problem, fold: Fold) -> Readings:
    """Everything but the frames' linearisation, folded."""
    line, m = problem.timeline, len(problem.start)
    encoders = np.full((len(line.t), m), np.nan)
    if problem.evidence.encoders is not None:
        encoders[line.encoders] = problem.evidence.encoders.values
    var = np.broadcast_to(problem.precision.encoder, encoders.shape)
    tracks, d = len(problem.evidence.sightings), 2
    shape = (fold.length, tracks, d)
    y, lines = np.full((*shape, fold.count), np.nan), np.ones((*shape, fold.count))
    jac = np.zeros((*shape, m, fold.count))
    dt = np.diff(line.t, prepend=line.t[0])
    return Readings(fold.fold(dt, 0.0), fold.fold(encoders, np.nan), fold.fold(var, 1.0), y, jac, lines)


def guesses(problem: Problem) -> tuple[Array, ...]:
    """First points of linearisation (F,M) per sighting: the encoders between their stamps, else the start."""
    return tuple(_angles(problem, sighting.t) for sighting in problem.evidence.sightings)


def _angles(problem: Problem, t: Array) -> Array:
    if problem.path is not None:
        return np.stack([np.interp(t, problem.path[0], column) for column in problem.path[1].T], axis=1)
    x = np.repeat(problem.start[None], len(t), axis=0)
    encoders = problem.evidence.encoders
    for j in range(len(problem.start)):
        if encoders is None:
            break
        known = np.isfinite(encoders.values[:, j])
        if known.any():
            x[:, j] = np.interp(t, encoders.t[known], encoders.values[known, j])
    return x


def starts(problem: Problem, fold: Fold, warm: Solution | None) -> tuple[Array, Array]:
    """Where each stretch starts, z (K,C), p (K,K,C): the prior for the first, as in `warm` or a guess for others."""
    z0, p0 = prior(problem)
    z, p = np.repeat(z0[:, None], fold.count, axis=1), np.repeat(p0[:, :, None], fold.count, axis=2)
    begin = problem.timeline.t[fold.first_events()]
    z[: len(problem.start), 1:] = _angles(problem, begin).T
    if warm is not None and warm.trace.z.shape[1] == len(z):
        return handed_over(z, p, warm.trace, fold)
    return z, p


def handed_over(z: Array, p: Array, trace: Trace, fold: Fold) -> tuple[Array, Array]:
    """Starts for the next sweep: each stretch begins where its predecessor ended."""
    z, p = z.copy(), p.copy()
    z[:, 1:], p[:, :, 1:] = trace.z[fold.handover, :, :-1], trace.p[fold.handover, :, :, :-1]
    return z, p


def far(z: Array, p: Array, next_z: Array, next_p: Array) -> float:
    """The most a start moved, in standard deviations."""
    std, before = (np.sqrt(np.maximum(np.einsum("iic->ic", cov), 1e-24)) for cov in (next_p, p))
    return float(max(np.abs((next_z - z) / std).max(), np.abs(before / std - 1.0).max()))

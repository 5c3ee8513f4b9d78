"""The generalised free-energy filter: belief over angles and rates, Gauss–Newton to convergence at every instant.

Under the Laplace approximation that is an iterated extended Kalman filter. All frames are linearised at once, all
stretches of the log are filtered side by side from the ends of their predecessors, and this is repeated until neither
the points of linearisation nor the starts move: the fixed point is the sequential filter's own.
"""

from dataclasses import dataclass

import numpy as np

from ..types import Array
from .folds import Fold, fold_for
from .habit import Habit
from .outset import handed_over, outset
from .precision import Precision
from .scan import Dynamics, Readings, Trace, rescan
from .senses import Evidence
from .tangents import RESTING, Tangents
from .timeline import Timeline

SWEEPS = 40
PATIENCE = 8
"""Sweeps without a new least move after which rest is given up."""
STUCK = 1e-3
"""Standard deviations: smaller moves are left to die out."""
SETTLED = 1e-8
"""Standard deviations: how little a stretch's start may still move."""


@dataclass(frozen=True, eq=False)
class Problem:
    """One log to be filtered: evidence, its instants, where the belief starts, the precisions.

    path: times (E,) s and angles (E,M) rad to linearise along first, where the encoders do not say · habit: where
    joints without an encoder are wont to be.
    """

    evidence: Evidence
    timeline: Timeline
    start: Array
    precision: Precision
    path: tuple[Array, Array] | None = None
    habit: Habit | None = None

    @property
    def dynamics(self) -> Dynamics:
        """How the state moves."""
        recalled = None if self.habit is None else self.habit.joints
        return Dynamics(self.precision.process, self.precision.drift, recalled)


@dataclass(frozen=True, eq=False)
class Solution:
    """A filtered log: fold, its readings as last linearised, their points (F,M) per sighting, trace."""

    fold: Fold
    readings: Readings
    points: tuple[Array, ...]
    trace: Trace


def solve(
    problem: Problem, warm: Solution | None = None, at: str = "posterior", rest: float = SETTLED
) -> Solution:
    """The sequential filter's fixed point; frames are linearised at the `posterior` (iterated) or the `prior` mean.

    `warm` is a solution of the same log to begin from; `rest` says how still starts (in std) must be to be done.
    """
    fold, line, m = fold_for(len(problem.timeline.t)), problem.timeline, len(problem.start)
    readings = heard(problem, fold)
    points, z, p = outset(problem, fold, readings, warm)
    tangents = Tangents(points, RESTING * rest / SETTLED)
    trace, moving, move, progress = None, np.ones(fold.count, bool), np.inf, Progress()
    for _ in range(SWEEPS):
        moving |= tangents.draw(problem, fold, readings)
        if trace is not None and not moving.any():
            return Solution(fold, readings, tangents.points, trace)
        trace = rescan(readings, problem.dynamics, z, p, moving, trace)
        means = trace.prior if at == "prior" else trace.z
        tangents.follow(tuple(fold.pick(means, events)[:, :m] for events in line.sightings))
        next_z, next_p = handed_over(z, p, trace, fold)
        moves = far(z, p, next_z, next_p)
        # a start that rests stays as it was scanned, so that small moves add up until they count
        moving, move = moves >= rest, float(moves.max())
        progress.note(move)
        z[:, moving], p[:, :, moving] = next_z[:, moving], next_p[:, :, moving]
    raise Restless(f"laplace: no rest after {SWEEPS} sweeps, last move {move:.2g}")


class Restless(Exception):
    """Sweeps over the log did not come to rest: the caller goes through it one instant after the other."""


def heard(problem: Problem, fold: Fold) -> Readings:
    """Everything but the frames' linearisation, folded."""
    line, m = problem.timeline, len(problem.start)
    encoders, var = encoder_rows(problem)
    tracks, d = len(problem.evidence.sightings), 2
    shape = (fold.length, tracks, d)
    y, lines = np.full((*shape, fold.count), np.nan), np.ones((*shape, fold.count))
    jac = np.zeros((*shape, m, fold.count))
    dt = np.diff(line.t, prepend=line.t[0])
    return Readings(fold.fold(dt, 0.0), fold.fold(encoders, np.nan), fold.fold(var, 1.0), y, jac, lines)


class Progress:
    """Whether sweeps still come closer to rest; Restless once they have not for PATIENCE sweeps."""

    def __init__(self) -> None:
        """Nothing moved yet."""
        self._least, self._stuck = np.inf, 0

    def note(self, move: float) -> None:
        """One more sweep, and how far starts moved in it, in standard deviations."""
        self._stuck = self._stuck + 1 if move > 0.9 * self._least and move > STUCK else 0
        self._least = min(self._least, move)
        if self._stuck > PATIENCE:
            raise Restless(f"no rest: {PATIENCE} sweeps have not come closer than {self._least:.2g}")


def encoder_rows(problem: Problem) -> tuple[Array, Array]:
    """Readings (E,M) rad, NaN where silent, and their variances (E,M); of joints without an encoder, their habit."""
    line = problem.timeline
    encoders = np.full((len(line.t), len(problem.start)), np.nan)
    if problem.evidence.encoders is not None:
        encoders[line.encoders] = problem.evidence.encoders.values
    var = np.tile(problem.precision.encoder, (len(line.t), 1))
    return (encoders, var) if problem.habit is None else problem.habit.fill(line.t, encoders, var)


def far(z: Array, p: Array, next_z: Array, next_p: Array) -> Array:
    """How far each start (C,) moved, in standard deviations."""
    std, before = (np.sqrt(np.maximum(np.einsum("iic->ic", cov), 1e-24)) for cov in (next_p, p))
    return np.asarray(np.maximum(np.abs((next_z - z) / std).max(axis=0), np.abs(before / std - 1.0).max(axis=0)))

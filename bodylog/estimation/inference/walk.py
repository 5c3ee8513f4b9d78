"""The filter one instant after the other, for logs whose encoders do not determine the arm: slower but robust."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from ...types import Array
from ..noise.correlated_noise import PAST, WHOLE, ErrorCorrelation, LastFrame, PendingFrame, reach
from ..noise.posture_prior import stationary
from .filter_records import Readings
from .folds import Fold, fold_for
from .initial_path import prior, priors
from .instant import RESTING, StepResult, hear
from .knot_problem import encoder_rows, full
from .motion import Motion
from .problem import Problem
from .reacquisition import SILENCE, AcquisitionState, forget
from .scan import scan
from .solution import Solution
from .tangents import Tangents

ROUGHLY = 1e-3
"""rad: tolerance of a path that only serves to linearise along first."""
FIRST = 4
"""Readings of an encoder that confirm the belief it started, or reset it if one of them was wrong."""


@dataclass(frozen=True, eq=False)
class Adrift:
    """Measurements `at` an instant with joints adrift: tracks, result."""

    at: int
    tracks: tuple[int, ...]
    result: StepResult


@dataclass(frozen=True, eq=False)
class Walked:
    """The filtered log: points (E,M) rad of linearisation, starts z (K,C), p (K,K,C) of a fold's stretches.

    resets: times (R,) s of resets and their joints (R,M), or None · watch: the last state · held (E,M) bool: joints
    silent for long · adrift: instants where images hardly determined some joints · moments (O,M): mean squares of the
    angles, from their usual mean, and of their derivatives, where encoders were read.
    """

    points: Array
    z: Array
    p: Array
    resets: tuple[Array, Array] | None
    watch: AcquisitionState
    held: Array
    adrift: tuple[Adrift, ...]
    moments: Array | None


def find_initial_path(problem: Problem) -> Problem:
    """Add resets, and a path to linearise along first where encoders do not give one."""
    line = problem.timeline.t
    few, often = _few(problem)
    doubted = bool((often & (first := _stepped(problem, PAST, RESTING, _only(few))).watch.mute(line[0])).any())
    if not doubted and not _quiet(problem, line[-1:]):
        return replace(problem, resets=first.resets)
    problem = _with_stationary(problem)
    whole = _stepped(problem, PAST, ROUGHLY, _only(len(line)))
    stepwise = doubted or _quiet(problem, line[:0]) or len(whole.adrift) > 0
    problem = replace(problem, path=(line, whole.points), resets=whole.resets, stepwise=stepwise)
    if problem.precision.learned is None:  # noise is not to be learned from the log
        return problem
    return _with_stationary(replace(problem, precision=replace(problem.precision, moments=whole.moments)))


def _with_stationary(problem: Problem) -> Problem:
    """The problem with the stationary motion of joints whose encoders are silent for long."""
    models = {sighting.name: sighting.model for sighting in problem.evidence.sightings}
    return replace(problem, stationary=stationary(models, problem.start, problem.precision))


def walk(problem: Problem, remember: bool = False) -> Solution:
    """The filter's solution; `remember` keeps gains, and counts frames, for the smoother, in one single stretch."""
    share, events = WHOLE if remember else PAST, len(problem.timeline.t)
    fold = _only(events) if remember else fold_for(events)
    found = _stepped(problem, share, RESTING, fold)
    tangents = Tangents(problem.evidence.sightings, tuple(found.points[rows] for rows in problem.timeline.sightings))
    tangents.share, readings = share, full(replace(problem, resets=found.resets), fold, found.held)
    tangents.draw(problem, fold, readings)
    if not found.adrift:
        return Solution(fold, readings, tangents, scan(readings, problem.dynamics, found.z, found.p, remember))
    _write(found.adrift, fold, readings)
    trace = scan(readings, problem.dynamics, found.z, found.p, remember)
    at = np.array([one.at for one in found.adrift])
    fold.put(trace.nats, at, np.array([one.result.nats for one in found.adrift]))
    return Solution(fold, readings, tangents, trace)


def _write(adrift: tuple[Adrift, ...], fold: Fold, readings: Readings) -> None:
    """Write the measurements of joints adrift into the readings."""
    for one in adrift:
        at, lines = np.array([one.at]), one.result.lines
        assert lines is not None
        for track, line in zip(one.tracks, lines.tracks, strict=True):
            parts = ((readings.y, line.y), (readings.jac, line.jac), (readings.var, line.var))
            for folded, row in parts:
                fold.put(folded[:, track, : len(row)], at, row[None])


def _only(events: int) -> Fold:
    """One single stretch."""
    return Fold(events, events, 1)


def _quiet(problem: Problem, end: Array) -> bool:
    """Whether an encoder is silent for long; `end` (0 or 1,) s: end of the log, if that counts."""
    encoders, line = problem.evidence.encoders, problem.timeline.t
    if encoders is None:
        return len(end) > 0
    known = [np.concatenate([line[:1], encoders.t[np.isfinite(column)], end]) for column in encoders.values.T]
    return max(float(np.diff(times).max(initial=0.0)) for times in known) > SILENCE


def _few(problem: Problem) -> tuple[int, Array]:
    """Instants until each encoder has FIRST readings, if soon; and which (M,) have more than one."""
    encoders, line = problem.evidence.encoders, problem.timeline
    soon = 0 if encoders is None else int(np.searchsorted(encoders.t, line.t[0] + SILENCE, "right"))
    if encoders is None or not soon:
        return 1, np.zeros(len(problem.start), bool)
    spoken = np.cumsum(np.isfinite(encoders.values[:soon]), axis=0)
    rows = int((spoken < np.minimum(FIRST, spoken[-1:])).any(axis=1).sum())
    return int(line.encoders[rows]) + 1, np.asarray(spoken[-1] > 1)


def _stepped(problem: Problem, share: float, resting: float, fold: Fold) -> Walked:
    """Filter up to the fold's last instant, each linearised until it moves less than `resting` rad."""
    line, motion, m = problem.timeline.t[: fold.events], Motion(problem.dynamics), len(problem.start)
    encoders, var = encoder_rows(problem, len(line))
    own = encoders if motion.is_prior is None else np.where(motion.is_prior, np.nan, encoders)
    points, lost, watch = np.empty((len(line), m)), dict[float, Array](), AcquisitionState.initial(m)
    sights, adrift, more = _sights(problem, share, len(line)), list[Adrift](), problem.more
    usual = problem.start if problem.stationary is None else problem.stationary.mean
    held, moments = np.zeros((len(line), m), bool), _Moments(motion.order, usual, line[0] + SILENCE)
    (z, p), (begin_z, begin_p) = prior(problem), priors(problem, fold)
    for k, dt in enumerate(np.diff(line, prepend=line[0])):
        if k and k % fold.length == 0:
            begin_z[:, k // fold.length], begin_p[..., k // fold.length] = z, p
        held[k] = watch.held(line[k])
        z, p = motion.move(z, p, dt, None if more is None else more[k], held[k])
        joints, borne = watch.judge(line[k], z, p, own[k], var[k], k in sights, motion.order)
        if joints is not None:
            forget(z, p, joints, own[k], dt, motion.order)
            lost[line[k]] = joints
        here = {track: watch.with_last_frame(track, sight) for track, sight in sights.get(k, ())}
        loose = bool(here) and watch.adrift(line[k])
        with _at(line[k]):
            found = hear(motion, z, p, encoders[k], var[k], list(here.values()), resting, loose)
        if loose:
            adrift.append(Adrift(k, tuple(here), found))
        z, p, points[k] = found.z, found.p, found.point
        moments.add(line[k], z, p, borne)
        watch = watch.after(line[k], borne, here, found.memories)
    resets = (np.array(list(lost)), np.array(list(lost.values()))) if lost else None
    return Walked(points, begin_z, begin_p, resets, watch, held, tuple(adrift), moments.found())


class _Moments:
    """Mean squares (O,M) of angles about `mean` (M,) and of their derivatives, where encoders are read after `begin`.

    Those of the estimates, and the least variance of these.
    """

    def __init__(self, order: int, mean: Array, begin: float) -> None:
        self._mean, self._begin, self._count = np.concatenate([mean, np.zeros((order - 1) * len(mean))]), begin, 0
        self._sum, self._least = np.zeros(len(self._mean)), np.full(len(self._mean), np.inf)
        self._shape = order, len(mean)

    def add(self, t: float, z: Array, p: Array, read: Array) -> None:
        """Add the state z (K,), p (K,K) at t (s), if all encoders were `read` (M,) bool."""
        if t > self._begin and read.all():
            size, self._count = len(self._mean), self._count + 1
            self._sum += np.square(z[:size] - self._mean)
            self._least = np.minimum(self._least, np.diagonal(p)[:size])

    def found(self) -> Array | None:
        """The mean squares; None if there were no readings."""
        return None if not self._count else (self._sum / self._count + self._least).reshape(self._shape)


@contextmanager
def _at(t: float) -> Iterator[None]:
    """Add the time t (s) to numerical errors."""
    try:
        yield
    except np.linalg.LinAlgError as problem:
        raise np.linalg.LinAlgError(f"at {t:.3f} s {problem}") from None


def _sights(problem: Problem, share: float, before: int) -> dict[int, list[tuple[int, PendingFrame]]]:
    """Frames by instant, and by track, of the first `before` instants."""
    found: dict[int, list[tuple[int, PendingFrame]]] = {}
    precision, line = problem.precision, problem.timeline
    for track, (sighting, events) in enumerate(zip(problem.evidence.sightings, line.sightings, strict=True)):
        scale, near = precision.scale.get(sighting.name, 1.0), precision.near.get(sighting.name, 0.0)
        like = ErrorCorrelation(precision.process, reach(sighting.model), near, share, order=precision.order)
        for row in np.flatnonzero(np.isfinite(sighting.values[: np.searchsorted(events, before)]).all(axis=1)):
            (values, var, mix), t = sighting.independent, float(sighting.t[row])
            own = None if mix is None else mix[row]
            sight = PendingFrame(sighting.model, t, values[row], scale * var[row], like, LastFrame(), own)
            found.setdefault(int(events[row]), []).append((track, sight))
    return found

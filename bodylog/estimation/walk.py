"""The filter one instant after the other, for logs whose encoders do not say where the arm is: slower, but sure."""

from dataclasses import dataclass, replace

import numpy as np

from ..types import Array
from .alike import PAST, WHOLE, Likeness, Memory, Sight, reach
from .brief import encoder_rows, full
from .folds import Fold, fold_for
from .instant import RESTING, Motion, hear
from .laplace import Problem, Solution
from .lost import SILENCE, Watch, forget
from .outset import prior, priors
from .scan import scan
from .tangents import Tangents

ROUGHLY = 1e-3
"""rad: near enough for a path that is only to be linearised along first."""
FIRST = 4
"""Readings of an encoder by which the belief it began is borne out, or begun anew where one of them is mistaken."""


@dataclass(frozen=True, eq=False)
class Walked:
    """The filter gone through: points (E,M) rad of linearisation, where a fold's stretches start, z (K,C), p (K,K,C).

    anew: when (R,) s it lost which joints (R,M), or None · watch: what it heard last.
    """

    points: Array
    z: Array
    p: Array
    anew: tuple[Array, Array] | None
    watch: Watch


def led(problem: Problem) -> Problem:
    """The problem with where it begins anew, and a path to linearise along first where encoders do not say that."""
    line = problem.timeline.t
    few, often = _few(problem)
    doubted = bool((often & (first := _stepped(problem, PAST, RESTING, _only(few))).watch.mute(line[0])).any())
    if not doubted and not _quiet(problem, line[-1:]):
        return replace(problem, anew=first.anew)
    whole = _stepped(problem, PAST, ROUGHLY, _only(len(line)))
    stepwise = doubted or _quiet(problem, line[:0])
    return replace(problem, path=(line, whole.points), anew=whole.anew, stepwise=stepwise)


def walk(problem: Problem, remember: bool = False) -> Solution:
    """The filter's solution; `remember` keeps gains, and counts frames, for the smoother, all in one single stretch."""
    share, events = WHOLE if remember else PAST, len(problem.timeline.t)
    fold = _only(events) if remember else fold_for(events)
    found = _stepped(problem, share, RESTING, fold)
    tangents = Tangents(problem.evidence.sightings, tuple(found.points[rows] for rows in problem.timeline.sightings))
    tangents.share, readings = share, full(replace(problem, anew=found.anew), fold)
    tangents.draw(problem, fold, readings)
    return Solution(fold, readings, tangents, scan(readings, problem.dynamics, found.z, found.p, remember))


def _only(events: int) -> Fold:
    """One single stretch."""
    return Fold(events, events, 1)


def _quiet(problem: Problem, end: Array) -> bool:
    """Whether an encoder is silent for long, up to the `end` (0 or 1,) s of the log if that is to count."""
    encoders, line = problem.evidence.encoders, problem.timeline.t
    if encoders is None:
        return len(end) > 0
    known = [np.concatenate([line[:1], encoders.t[np.isfinite(column)], end]) for column in encoders.values.T]
    return max(float(np.diff(times).max(initial=0.0)) for times in known) > SILENCE


def _few(problem: Problem) -> tuple[int, Array]:
    """Instants until each encoder has spoken FIRST times, if soon; and which (M,) have more than once."""
    encoders, line = problem.evidence.encoders, problem.timeline
    soon = 0 if encoders is None else int(np.searchsorted(encoders.t, line.t[0] + SILENCE, "right"))
    if encoders is None or not soon:
        return 1, np.zeros(len(problem.start), bool)
    spoken = np.cumsum(np.isfinite(encoders.values[:soon]), axis=0)
    rows = int((spoken < np.minimum(FIRST, spoken[-1:])).any(axis=1).sum())
    return int(line.encoders[rows]) + 1, np.asarray(spoken[-1] > 1)


def _stepped(problem: Problem, share: float, resting: float, fold: Fold) -> Walked:
    """The filter up to the fold's last instant, each linearised anew until that moves less than `resting` rad."""
    line, motion, m = problem.timeline.t[: fold.events], Motion(problem.dynamics), len(problem.start)
    encoders, var = encoder_rows(problem, len(line))
    own = encoders if motion.recalled is None else np.where(motion.recalled, np.nan, encoders)
    points, lost, watch = np.empty((len(line), m)), dict[float, Array](), Watch.begun(m)
    sights, more = _sights(problem, share, len(line)), problem.more
    (z, p), (begin_z, begin_p) = prior(problem), priors(problem, fold)
    for k, dt in enumerate(np.diff(line, prepend=line[0])):
        if k and k % fold.length == 0:
            begin_z[:, k // fold.length], begin_p[..., k // fold.length] = z, p
        z, p = motion.move(z, p, dt, None if more is None else more[k])
        joints, borne = watch.judge(line[k], z, p, own[k], var[k])
        if joints is not None:
            forget(z, p, joints, own[k])
            lost[line[k]] = joints
        here = {track: watch.remembered(track, sight) for track, sight in sights.get(k, ())}
        found = hear(motion, z, p, encoders[k], var[k], list(here.values()), resting)
        z, p, points[k] = found.z, found.p, found.point
        watch = watch.after(line[k], borne, here, found.memories)
    anew = (np.array(list(lost)), np.array(list(lost.values()))) if lost else None
    return Walked(points, begin_z, begin_p, anew, watch)


def _sights(problem: Problem, share: float, before: int) -> dict[int, list[tuple[int, Sight]]]:
    """What is seen of which track, by instant, `before` some one."""
    found: dict[int, list[tuple[int, Sight]]] = {}
    precision, line = problem.precision, problem.timeline
    for track, (sighting, events) in enumerate(zip(problem.evidence.sightings, line.sightings, strict=True)):
        scale, near = precision.scale.get(sighting.name, 1.0), precision.near.get(sighting.name, 0.0)
        like = Likeness(precision.process, reach(sighting.model), near, share)
        for row in np.flatnonzero(np.isfinite(sighting.values[: np.searchsorted(events, before)]).all(axis=1)):
            value, var, k = sighting.values[row], scale * sighting.var[row], int(events[row])
            sight = Sight(sighting.model, float(sighting.t[row]), value, var, like, Memory())
            found.setdefault(k, []).append((track, sight))
    return found

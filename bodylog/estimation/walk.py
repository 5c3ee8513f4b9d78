"""The filter one instant after the other, for logs whose encoders do not say where the arm is: slower, but sure."""

from dataclasses import replace

import numpy as np

from ..types import Array
from .alike import PAST, WHOLE, Likeness, Memory, Sight, reach
from .brief import encoder_rows, full
from .folds import Fold
from .instant import RESTING, Motion, hear
from .laplace import Problem, Solution
from .outset import prior, priors
from .scan import scan
from .tangents import Tangents

ROUGHLY = 1e-3
"""rad: near enough for a path that is only to be linearised along first."""
GAP = 1.0
"""s: a joint silent for longer cannot be guessed from its own readings."""


def silent(problem: Problem) -> bool:
    """Whether some joint is silent for long while vision speaks."""
    encoders, line = problem.evidence.encoders, problem.timeline.t
    if not problem.evidence.sightings:
        return False
    if encoders is None:
        return True
    known = [np.concatenate([line[:1], encoders.t[np.isfinite(c)], line[-1:]]) for c in encoders.values.T]
    return max(float(np.diff(k).max()) for k in known) > GAP


def led(problem: Problem) -> Problem:
    """The problem with a path to linearise along first, where the encoders do not give one."""
    if not silent(problem):
        return problem
    return replace(problem, path=(problem.timeline.t, _points(problem, PAST, ROUGHLY)))


def walk(problem: Problem, remember: bool = False) -> Solution:
    """The filter's solution as one single stretch; `remember` keeps gains, and counts frames, for the smoother."""
    share, events = WHOLE if remember else PAST, len(problem.timeline.t)
    points, fold = _points(problem, share, RESTING), Fold(events, events, 1)
    tangents = Tangents(problem.evidence.sightings, tuple(points[frames] for frames in problem.timeline.sightings))
    tangents.share, readings = share, full(problem, fold)
    tangents.draw(problem, fold, readings)
    z, p = priors(problem, fold)
    return Solution(fold, readings, tangents, scan(readings, problem.dynamics, z, p, remember))


def _points(problem: Problem, share: float, resting: float) -> Array:
    """Where (E,M) rad the filter is linearised, each instant anew until that moves less than `resting` rad."""
    line, motion = problem.timeline, Motion(problem.dynamics)
    encoders, var = encoder_rows(problem)
    points, memory = np.empty(encoders.shape), dict.fromkeys(range(len(line.sightings)), Memory())
    sights = _sights(problem, share)
    z, p = prior(problem)
    for k, dt in enumerate(np.diff(line.t, prepend=line.t[0])):
        here = [(track, replace(sight, memory=memory[track])) for track, sight in sights.get(k, ())]
        found = hear(motion, z, p, dt, encoders[k], var[k], [sight for _, sight in here], resting)
        z, p, points[k] = found.z, found.p, found.point
        memory |= {track: after for (track, _), after in zip(here, found.memories, strict=True)}
    return points


def _sights(problem: Problem, share: float) -> dict[int, list[tuple[int, Sight]]]:
    """What is seen of which track, by instant."""
    found: dict[int, list[tuple[int, Sight]]] = {}
    precision, line = problem.precision, problem.timeline
    for track, (sighting, events) in enumerate(zip(problem.evidence.sightings, line.sightings, strict=True)):
        scale, near = precision.scale.get(sighting.name, 1.0), precision.near.get(sighting.name, 0.0)
        like = Likeness(precision.process, reach(sighting.model), near, share)
        for row in np.flatnonzero(np.isfinite(sighting.values).all(axis=1)):
            value, var, k = sighting.values[row], scale * sighting.var[row], int(events[row])
            sight = Sight(sighting.model, float(sighting.t[row]), value, var, like, Memory())
            found.setdefault(k, []).append((track, sight))
    return found

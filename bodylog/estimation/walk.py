"""The filter one instant after the other, for logs whose encoders do not say where the arm is: slower, but sure."""

from dataclasses import fields, replace

import numpy as np

from ..types import Array
from .alike import PAST, WHOLE, Memory, Sight
from .brief import encoder_rows
from .folds import Fold
from .instant import RESTING, hear
from .laplace import Problem, Solution
from .outset import prior
from .scan import Readings, Trace
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
    solution = walk(problem, resting=ROUGHLY)
    return replace(problem, path=(problem.timeline.t, solution.trace.z[:, : len(problem.start), 0]))


def walk(problem: Problem, remember: bool = False, resting: float = RESTING) -> Solution:
    """The filter's solution as one single stretch, each instant linearised until it moves less than `resting` rad."""
    line, m = problem.timeline, len(problem.start)
    encoders, var = encoder_rows(problem)
    rows = [np.full(len(line.t), -1) for _ in line.sightings]
    for row, events in zip(rows, line.sightings, strict=True):
        row[events] = np.arange(len(events))
    memory, steps = [Memory() for _ in rows], []
    pace = problem.precision.process * (WHOLE if remember else PAST)
    z, p = prior(problem)
    for k, dt in enumerate(np.diff(line.t, prepend=line.t[0])):
        sights = _sights(problem, k, [int(row[k]) for row in rows], memory, pace)
        steps.append(hear(problem.dynamics, z, p, dt, encoders[k], var[k], sights, remember, resting))
        z, p = steps[-1][1].z[0, :, 0], steps[-1][1].p[0, :, :, 0]
        memory = [sight.after(z[:m]) for sight in sights]
    readings, trace = _joined([r for r, _ in steps]), _joined_traces([t for _, t in steps])
    points = tuple(trace.z[events, :m, 0] for events in line.sightings)
    return Solution(Fold(len(line.t), len(line.t), 1), readings, Tangents(problem.evidence.sightings, points), trace)


def _sights(problem: Problem, instant: int, rows: list[int], memory: list[Memory], pace: Array) -> list[Sight]:
    found, t = [], float(problem.timeline.t[instant])
    for sighting, row, kept in zip(problem.evidence.sightings, rows, memory, strict=True):
        value = sighting.values[row] if row >= 0 else np.full(2, np.nan)
        scale = problem.precision.scale.get(sighting.name, 1.0)
        var, near = scale * sighting.var[max(row, 0)], problem.precision.near.get(sighting.name, 0.0)
        found.append(Sight(sighting.model, t, value, var, pace, near, kept))
    return found


def _joined(parts: list[Readings]) -> Readings:
    return Readings(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Readings)))


def _joined_traces(parts: list[Trace]) -> Trace:
    whole = {
        f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Trace) if f.name != "back"
    }
    gains = [part.back for part in parts if part.back is not None]
    if not gains:
        return Trace(**whole, back=None)
    gain, weight, nu = (np.concatenate(column) for column in zip(*gains, strict=True))
    return Trace(**whole, back=(gain, weight, nu))

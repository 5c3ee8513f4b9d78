"""Where a folded log's stretches start and its frames are linearised first: by the encoders alone, or as before."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..types import Array
from .folds import Fold
from .scan import Readings, scan
from .tangents import Tangents

if TYPE_CHECKING:
    from .laplace import Problem, Solution

START_STD = 1.0
"""rad and rad/s: how little is known of angles and rates before the first reading."""
OFFSET_STD = 0.01
"""rad: how far an encoder that is allowed an offset may be off before the first reading."""
PASSES = 2
"""Once from a guess, to find where each stretch's successor starts, and once more from there."""


def prior(problem: "Problem") -> tuple[Array, Array]:
    """State z (K,) and covariance p (K,K) before anything is heard."""
    m, drift = len(problem.start), problem.precision.drift
    z = np.concatenate([problem.start, np.zeros(problem.dynamics.size - m)])
    var = np.full(len(z), START_STD**2)
    if drift is not None:
        var[2 * m :] = np.where(drift > 0, OFFSET_STD**2, 0.0)
    return z, np.diag(var)


def priors(problem: "Problem", fold: Fold) -> tuple[Array, Array]:
    """The prior (K,C), (K,K,C) for every stretch."""
    z, p = prior(problem)
    return np.repeat(z[:, None], fold.count, axis=1), np.repeat(p[:, :, None], fold.count, axis=2)


def starts(problem: "Problem", fold: Fold, known: "Solution", events: Array) -> tuple[Array, Array]:
    """Each stretch's start z (K,C), p (K,K,C) as a solution has it at its `events` (C−1,); new offsets as at first."""
    z, p = priors(problem, fold)
    k = min(len(z), known.trace.z.shape[1])
    z[:k, 1:] = known.fold.pick(known.trace.z, events)[:, :k].T
    p[:k, :k, 1:] = np.moveaxis(known.fold.pick(known.trace.p, events)[:, :k, :k], 0, -1)
    return z, p


def handed_over(z: Array, p: Array, z_end: Array, p_end: Array) -> tuple[Array, Array]:
    """Starts for the next sweep: each stretch begins where its predecessor ended."""
    z, p = z.copy(), p.copy()
    z[:, 1:], p[:, :, 1:] = z_end[:, :-1], p_end[:, :, :-1]
    return z, p


def outset(problem: "Problem", fold: Fold, readings: Readings) -> tuple[Tangents, Array, Array]:
    """Tangents at the path, or where encoders alone have the joints, and each stretch's start z (K,C), p (K,K,C)."""
    (z, p), t = priors(problem, fold), problem.timeline.t
    path, sightings = problem.path or _said(problem), problem.evidence.sightings
    z[: len(problem.start), 1:] = _between(path, problem.start, t[fold.lasts()]).T
    points = tuple(_between(path, problem.start, sighting.t) for sighting in sightings)
    if problem.path is None and problem.evidence.encoders is not None:
        blind = replace(readings, y=np.full_like(readings.y, np.nan))
        for _ in range(PASSES):
            trace = scan(blind, problem.dynamics, z, p)
            z, p = handed_over(z, p, trace.z[-1], trace.p[-1])
        points = tuple(fold.pick(trace.z, events)[:, : len(problem.start)] for events in problem.timeline.sightings)
    return Tangents(sightings, points), z, p


def _said(problem: "Problem") -> tuple[Array, Array]:
    encoders = problem.evidence.encoders
    return (np.empty(0), np.empty((0, len(problem.start)))) if encoders is None else (encoders.t, encoders.values)


def _between(path: tuple[Array, Array], start: Array, at: Array) -> Array:
    """Angles (N,M) at the times `at`, between those of the path (t, angles) that are known, else the start's."""
    x = np.repeat(start[None], len(at), axis=0)
    for j, column in enumerate(path[1].T):
        known = np.isfinite(column)
        if known.any():
            x[:, j] = np.interp(at, path[0][known], column[known])
    return x

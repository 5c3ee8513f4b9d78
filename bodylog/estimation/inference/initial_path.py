"""Initial starts of a folded log's stretches and initial linearisation points of its frames."""

from typing import TYPE_CHECKING

import numpy as np

from ...types import Array
from .filter_records import Dynamics, KnotReadings, Pooled
from .folds import Fold
from .reacquisition import START_STD
from .scan import scan
from .tangents import Tangents

if TYPE_CHECKING:
    from .problem import Problem
    from .solution import Solution

OFFSET_STD = 0.01
"""rad: prior standard deviation of an encoder offset."""


def prior(problem: "Problem") -> tuple[Array, Array]:
    """State z (K,) and covariance p (K,K) before any measurement."""
    return prior_of(problem.start, problem.dynamics)


def prior_of(start: Array, dynamics: Dynamics) -> tuple[Array, Array]:
    """State z (K,) and covariance p (K,K) at the angles `start` (M,) rad, before any measurement."""
    var = np.repeat(np.square(START_STD[: dynamics.order]), len(start))
    if dynamics.drift is not None:
        var = np.append(var, np.where(dynamics.drift > 0, OFFSET_STD**2, 0.0))
    return np.concatenate([start, np.zeros(dynamics.size - len(start))]), np.diag(var)


def priors(problem: "Problem", fold: Fold) -> tuple[Array, Array]:
    """The prior (K,C), (K,K,C) for every stretch."""
    z, p = prior(problem)
    return np.repeat(z[:, None], fold.count, axis=1), np.repeat(p[:, :, None], fold.count, axis=2)


def starts(problem: "Problem", fold: Fold, known: "Solution", events: Array) -> tuple[Array, Array]:
    """Each stretch's start z (K,C), p (K,K,C) from a solution at its `events` (C−1,); new offsets from the prior."""
    z, p = priors(problem, fold)
    k = min(len(z), known.trace.z.shape[1])
    z[:k, 1:] = known.fold.pick(known.trace.z, events)[:, :k].T
    p[:k, :k, 1:] = np.moveaxis(known.fold.pick(known.trace.p, events)[:, :k, :k], 0, -1)
    return z, p


def handed_over(z: Array, p: Array, z_end: Array, p_end: Array) -> tuple[Array, Array]:
    """Starts for the next sweep: each stretch starts from its predecessor's end."""
    z, p = z.copy(), p.copy()
    z[:, 1:], p[:, :, 1:] = z_end[:, :-1], p_end[:, :, :-1]
    return z, p


def initial_tangents(problem: "Problem", fold: Fold, readings: KnotReadings) -> tuple[Tangents, Array, Array]:
    """Tangents at the initial path, or at the angles from encoders alone; each stretch's start z (K,C), p (K,K,C)."""
    (z, p), t = priors(problem, fold), problem.timeline.t
    path, sightings = problem.path or _encoder_path(problem), problem.evidence.sightings
    z[: len(problem.start), 1:] = _between(path, problem.start, t[fold.lasts()]).T
    points = tuple(_between(path, problem.start, sighting.t) for sighting in sightings)
    if problem.path is None and problem.evidence.encoders is not None:
        path_z, z, p = _reckon(readings, problem.dynamics, z, p)
        points = tuple(fold.pick(path_z, events)[:, : len(problem.start)] for events in problem.timeline.sightings)
    return Tangents(sightings, points), z, p


def _reckon(readings: KnotReadings, dynamics: Dynamics, z: Array, p: Array) -> tuple[Array, Array, Array]:
    """States (L,K,C) from encoders alone, given guesses z (K,C), p (K,K,C); and the starts of the stretches.

    Without images joints are independent: each joint of a stretch is scanned as its own stretch.
    """
    length, m, c = readings.encoders.shape
    s = len(z) // m

    def apart(a: Array) -> Array:
        """(L,…,M,C) -> (L,…,1,M·C)."""
        return a.reshape(*a.shape[:-2], 1, m * c)

    between = readings.pooled
    unseen = np.empty((length, 0, 2, m * c)), np.empty((length, 0, 2, 1, m * c)), np.empty((length, 0, 2, m * c))
    order = dynamics.order
    alone = KnotReadings(
        np.tile(readings.dt, m), apart(readings.encoders), apart(readings.encoder_var), *unseen,
        Pooled(
            apart(between.y), apart(between.var), apart(between.lean), apart(between.move), apart(between.shift),
            apart(between.noise), np.zeros((length, m * c)),
        ),
        reset=None if readings.reset is None else apart(readings.reset),
    )  # fmt: skip
    own = np.einsum("ajbjc->abjc", p.reshape(s, m, s, m, c)).reshape(s, s, m * c)
    one = Dynamics(np.ones(1), None if s == order else np.zeros(1), order=order)
    trace = scan(alone, one, z.reshape(s, m * c), own)
    whole = np.zeros((s, m, s, m, c))
    np.einsum("ajbjc->abjc", whole)[:] = trace.p[-1].reshape(s, s, m, c)
    z, p = handed_over(z, p, trace.z[-1].reshape(z.shape), whole.reshape(p.shape))
    return trace.z.reshape(length, *z.shape), z, p


def _encoder_path(problem: "Problem") -> tuple[Array, Array]:
    encoders = problem.evidence.encoders
    return (np.empty(0), np.empty((0, len(problem.start)))) if encoders is None else (encoders.t, encoders.values)


def _between(path: tuple[Array, Array], start: Array, at: Array) -> Array:
    """Angles (N,M) at the times `at`, interpolated on the path (t, angles); the start angles where it is unknown."""
    x = np.repeat(start[None], len(at), axis=0)
    for j, column in enumerate(path[1].T):
        known = np.isfinite(column)
        if known.any():
            x[:, j] = np.interp(at, path[0][known], column[known])
    return x

"""Where a folded log's stretches start and its frames are linearised first: by the encoders alone, or as before."""

from typing import TYPE_CHECKING

import numpy as np

from ..types import Array
from .folds import Fold
from .scan import Readings, Trace

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


def handed_over(z: Array, p: Array, trace: Trace, fold: Fold) -> tuple[Array, Array]:
    """Starts for the next sweep: each stretch begins where its predecessor ended; new offsets stay as they are."""
    z, p, k = z.copy(), p.copy(), min(len(z), trace.z.shape[1])
    z[:k, 1:], p[:k, :k, 1:] = trace.z[fold.handover, :k, :-1], trace.p[fold.handover, :k, :k, :-1]
    return z, p


def outset(
    problem: "Problem", fold: Fold, readings: Readings, warm: "Solution | None"
) -> tuple[tuple[Array, ...], Array, Array]:
    """Points of linearisation (F,M) per sighting, and each stretch's start z (K,C), p (K,K,C), to begin with."""
    z, p = priors(problem, fold)
    if warm is not None:
        return warm.points, *(handed_over(z, p, warm.trace, fold) if warm.fold == fold else (z, p))
    path, t = problem.path or _said(problem), problem.timeline.t
    z[: len(problem.start), 1:] = _between(path, problem.start, t[fold.first_events()]).T
    if problem.path is None and problem.evidence.encoders is not None:
        path = t, _reckon(problem, fold, readings, z, p)
    return tuple(_between(path, problem.start, sighting.t) for sighting in problem.evidence.sightings), z, p


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


def _reckon(problem: "Problem", fold: Fold, readings: Readings, z: Array, p: Array) -> Array:
    """Angles (E,M) by the encoders alone, NaN where silent; z (K,C), p (K,K,C) become where they start each stretch.

    One constant velocity filter per joint: without frames and offsets joints know nothing of each other.
    """
    m, heard = len(problem.start), np.isfinite(readings.encoders)
    joints = np.arange(m)
    blocks = (joints, joints), (joints, joints + m), (joints + m, joints), (joints + m, joints + m)
    for _ in range(PASSES):
        state = z[:m], z[m : 2 * m], *(p[blocks[k]] for k in (0, 1, 3))
        path, after = _alone(readings, heard, problem.precision.process[:, None], state, fold.handover)
        z[: 2 * m, 1:] = np.concatenate(after[:2])[:, :-1]
        for block, var in zip(blocks, (after[2], after[3], after[3], after[4]), strict=True):
            p[*block, 1:] = var[:, :-1]
    return fold.unfold(np.where(heard, path, np.nan))


def _alone(
    readings: Readings, heard: Array, q: Array, state: tuple[Array, ...], keep: int
) -> tuple[Array, tuple[Array, ...]]:
    """Angles (L,M,C) from a state of angles x, rates v, variances xx, xv, vv (M,C); the state after instant `keep`."""
    said, weight, path = np.where(heard, readings.encoders, 0.0), heard.astype(float), np.empty(heard.shape)
    x, v, xx, xv, vv = state
    for i, dt in enumerate(readings.dt):
        moved, qdt = xv + dt * vv, q * dt
        x, xx = x + dt * v, xx + dt * (xv + moved + qdt * dt / 3.0)
        xv, vv = moved + 0.5 * dt * qdt, vv + qdt
        share = weight[i] / (xx + readings.encoder_var[i])
        nu, gain_x, gain_v = said[i] - x, share * xx, share * xv
        x, v = x + gain_x * nu, v + gain_v * nu
        xx, xv, vv = xx - gain_x * xx, xv - gain_x * xv, vv - gain_v * xv
        path[i] = x
        if i == keep:
            kept = x, v, xx, xv, vv
    return path, kept

"""Initial starts of a folded log's stretches and initial linearisation points of its frames."""

from typing import TYPE_CHECKING

import numpy as np

from ...types import Array
from ..measurements.records import interpolate_values
from .filter_records import FilterDynamics
from .folds import Fold
from .reacquisition import START_STD
from .tangents import Tangents

if TYPE_CHECKING:
    from .problem import FilterProblem
    from .solution import Solution

OFFSET_STD = 0.01
"""rad: prior standard deviation of an encoder offset;
with 0.003 and 0.03 errors of drawn logs stay within .4 %.
"""


def state_prior(start: Array, dynamics: FilterDynamics) -> tuple[Array, Array]:
    """State z (K,) and covariance p (K,K) at the
    angles `start` (M,) rad, before any measurement.
    """
    var = np.repeat(np.square(START_STD[: dynamics.order]), len(start))
    if dynamics.drift is not None:
        var = np.append(var, np.where(dynamics.drift > 0, OFFSET_STD**2, 0.0))
    return np.concatenate([start, np.zeros(dynamics.size - len(start))]), np.diag(var)


def stretch_priors(problem: "FilterProblem", fold: Fold) -> tuple[Array, Array]:
    """The prior (K,C), (K,K,C) for every stretch."""
    z, p = state_prior(problem.start, problem.dynamics)
    return np.repeat(z[:, None], fold.count, axis=1), np.repeat(p[:, :, None], fold.count, axis=2)


def starts_from_solution(
    problem: "FilterProblem", fold: Fold, known: "Solution"
) -> tuple[Array, Array]:
    """Each stretch's start z (K,C), p (K,K,C) from a
    solution of the same log; new offsets from the prior.
    """
    (z, p), lasts = stretch_priors(problem, fold), fold.lasts()
    k = min(len(z), known.trace.z.shape[1])
    z[:k, 1:] = known.fold.pick(known.trace.z, lasts)[:, :k].T
    if known.fold == fold:
        p[:k, :k, 1:] = known.trace.end_p[:k, :k, :-1]
    return z, p


def hand_over_starts(z: Array, p: Array, z_end: Array, p_end: Array) -> tuple[Array, Array]:
    """Starts for the next sweep: each stretch starts from its predecessor's end."""
    z = z.copy()
    p = p.copy()
    z[:, 1:], p[:, :, 1:] = z_end[:, :-1], p_end[:, :, :-1]
    return z, p


def initial_tangents(problem: "FilterProblem", fold: Fold) -> tuple[Tangents, Array, Array]:
    """Tangents at the initial path, or at the encoders'
    readings; each stretch's start z (K,C), p (K,K,C).
    """
    (z, p), t = stretch_priors(problem, fold), problem.timeline.t
    encoders = problem.evidence.encoders
    sightings = problem.evidence.sightings
    path = problem.path or (None if encoders is None else (encoders.t, encoders.values))
    z[: len(problem.start), 1:] = _interpolate_path(path, problem.start, t[fold.lasts()]).T
    return (
        Tangents(
            sightings,
            tuple(_interpolate_path(path, problem.start, sighting.t) for sighting in sightings),
        ),
        z,
        p,
    )


def _interpolate_path(path: tuple[Array, Array] | None, start: Array, at: Array) -> Array:
    """Angles (N,M) at the times `at`, interpolated on the
    path (t, angles); the start angles where it is unknown.
    """
    x = np.repeat(start[None], len(at), axis=0)
    known = x if path is None else interpolate_values(*path, at)
    return np.where(np.isfinite(known), known, x)

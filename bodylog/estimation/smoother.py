"""The full-interval posterior: Gauss–Newton over the whole log, each round one filter forth and one adjoint back.

Linearising all frames at the smoothed angles until they rest gives the maximum a posteriori path. The way back is the
Bryson–Frazier form, which needs the filter's gains but no inverse.
"""

from dataclasses import dataclass

import numpy as np

from ..settings import Estimation
from ..types import Array, BodyModel, Estimate, Features
from . import adjoint, results
from .filtering import drifts, pose, settled
from .folds import Fold, fold_for
from .laplace import SWEEPS, Problem, Progress, Restless, Solution, far, heard
from .outset import handed_over, outset
from .results import Beliefs
from .scan import Readings, Trace, rescan
from .tangents import Tangents
from .walk import walk

FORTH = 1
"""Sweeps that only go forth, until the stretches start nearly where they should."""


TURNS = 2
"""Ways back at most for one way forth, of which they cost a quarter."""
STILL = 1e-7
"""rad: a frame whose point on the path moves less keeps its tangent."""
LASTING = 1e-6
"""Standard deviations: how little a stretch's start and end may still move."""


@dataclass(frozen=True, eq=False)
class Smooth(Solution):
    """A smoothed log: with the last way forth, the smoothed state z (L,K,C), and cov (L,M,M,C) of the angles."""

    z: Array
    cov: Array


def estimate(features: Features, body: BodyModel, settings: Estimation) -> Estimate:
    """Smoothed belief: at each output time, all that the whole log says about it."""
    problem, warm, faults = pose(features, body, settings)
    problem, smooth = settled(problem, warm, settings, solve, once)
    unfold, m, precision = smooth.fold.unfold, len(problem.start), problem.precision
    z, cov = unfold(smooth.z), unfold(smooth.cov)
    beliefs = Beliefs(
        z, cov, unfold(smooth.trace.nats), z[:, :m], cov, unfold(smooth.trace.encoder_d), precision.scale,
        precision.plain(), (*faults, *drifts(problem, body.joints, smooth, faults)),
    )  # fmt: skip
    return results.estimate("smoother", body, problem.evidence, problem.timeline, beliefs)


def solve(problem: Problem, warm: Solution | None = None) -> Smooth:
    """The maximum a posteriori path; Restless when the rounds do not settle."""
    fold, line, m = fold_for(len(problem.timeline.t)), problem.timeline, len(problem.start)
    readings = heard(problem, fold)
    points, z, p = outset(problem, fold, readings, warm)
    tangents, forth = Tangents(points, STILL), FORTH if warm is None else 0
    ends, smooth, moving, rest = np.zeros_like(z), None, np.ones(fold.count, bool), np.inf
    trace, progress = None, Progress()
    for sweep in range(SWEEPS):
        moving |= tangents.draw(problem, fold, readings)
        if trace is not None and smooth is not None and rest < LASTING and not moving.any():
            return Smooth(fold, readings, tangents.points, trace, smooth, spread(readings, trace, fold))
        trace = rescan(readings, problem.dynamics, z, p, moving, trace, remember=True)
        next_z, next_p = handed_over(z, p, trace, fold)
        moves = far(z, p, next_z, next_p)
        moving, rest = moves >= LASTING, float(moves.max())
        progress.note(rest)
        z[:, moving], p[:, :, moving] = next_z[:, moving], next_p[:, :, moving]
        if sweep >= forth:
            smooth, ends, pulled = _back(readings, trace, ends, p, fold, rest)
            rest = max(rest, pulled)
        tangents.follow(
            tuple(fold.pick(trace.z if smooth is None else smooth, events)[:, :m] for events in line.sightings)
        )
    raise Restless(f"smoother: no rest after {SWEEPS} sweeps, last move {rest:.2g}")


def _back(
    readings: Readings, trace: Trace, ends: Array, p: Array, fold: Fold, rest: float
) -> tuple[Array, Array, float]:
    """Smoothed state (L,K,C) and ends (K,C), gone back again while ends move more than starts did; their last move."""
    for _ in range(TURNS):
        smooth, at_start = adjoint.means(readings, trace, ends, fold.takeover)
        pulled, ends = _pulled(adjoint.before(at_start) - ends, p), adjoint.before(at_start)
        if pulled <= max(rest, LASTING):
            break
    return smooth, ends, pulled


def spread(readings: Readings, trace: Trace, fold: Fold) -> Array:
    """Smoothed covariance (L,M,M,C) of the angles, once what the future says at each stretch's end rests."""
    ends, std = np.zeros_like(trace.p[0]), np.sqrt(np.einsum("iic->ic", trace.p[fold.handover]))
    for _ in range(SWEEPS):
        cov, at_start = adjoint.covariances(readings, trace, ends, fold.takeover)
        moved, ends = adjoint.before(at_start) - ends, adjoint.before(at_start)
        if np.abs(moved * std[:, None] * std[None]).max() < LASTING:
            return cov
    raise Restless(f"smoother: no rest of covariances after {SWEEPS} sweeps")


def once(problem: Problem) -> Smooth:
    """The path smoothed one time along the filter's own tangents: what is left where rounds do not come to rest."""
    solution, k = walk(problem, remember=True), problem.dynamics.size
    smooth, _ = adjoint.means(solution.readings, solution.trace, np.zeros((k, 1)), 0)
    cov, _ = adjoint.covariances(solution.readings, solution.trace, np.zeros((k, k, 1)), 0)
    return Smooth(solution.fold, solution.readings, solution.points, solution.trace, smooth, cov)


def _pulled(adjoint_moved: Array, p: Array) -> float:
    """The most the future's word (K,C) moved any stretch's end, in standard deviations; p (K,K,C) sets the scale."""
    return float(np.abs(adjoint_moved * np.sqrt(np.maximum(np.einsum("iic->ic", p), 0.0))).max())

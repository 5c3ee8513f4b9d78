"""The full-interval posterior: Gauss–Newton over the whole log; each round is a forward filter and an adjoint pass.

Linearising all frames at the smoothed angles until convergence gives the maximum a posteriori path. The backward pass
has the Bryson–Frazier form, which needs the filter's gains but no inverse.
"""

import numpy as np

from ...body_model import BodyModel
from ...settings import Estimation
from ...types import Array, Estimate, Features
from ..inference import adjoint
from ..inference.convergence import RESTING, SWEEPS, DidNotConverge, sure
from ..inference.filter_records import Readings
from ..inference.folds import Fold, fold_for
from ..inference.gauss_newton import far, initial_sweep
from ..inference.initial_path import handed_over, starts
from ..inference.knot_problem import full
from ..inference.leave_one_out import free_energy, left_out, outliers, without
from ..inference.problem import Problem
from ..inference.scan import Trace, rescan
from ..inference.solution import Path, Smooth, Solution
from ..inference.tangents import Tangents
from ..inference.walk import walk
from ..noise.correlated_noise import WHOLE
from . import results
from .filtering import drifts, gathered, kept, lost, settled, shown, tuned
from .results import Beliefs

TURNS = 2
"""Most backward passes per forward pass, of which they cost a quarter."""
LASTING = 1e-6
"""Standard deviations: tolerance on a stretch's start and end."""


def estimate(features: Features, body: BodyModel, settings: Estimation) -> Estimate:
    """Smoothed belief at each output time, given the whole log."""
    start_problem, faults = gathered(features, body, settings)

    def solved(problem: Problem) -> tuple[Problem, Smooth]:
        problem, warm = tuned(problem, settings)
        solver = (lambda posed, _: once(posed)) if problem.stepwise else solve
        problem, smooth = settled(problem, warm, settings, solver, once)
        return problem, judged(problem, smooth)

    problem, smooth = kept(start_problem, solved)
    found = left_out(problem, smooth)
    unfold, m, precision = smooth.fold.unfold, len(problem.start), problem.precision
    z, cov = unfold(smooth.z), precision.of(unfold(smooth.cov)[:, :m, :m], problem.held)
    errors = np.full((*problem.timeline.t.shape, m), np.nan)
    errors[problem.timeline.encoders] = found.encoders
    beliefs = Beliefs(
        shown(z, problem), cov, free_energy(problem, smooth, found), z[:, :m], cov, errors,
        precision.scale, precision.plain(), drifts(problem, body.joints, smooth, faults),
        tuple(lost(problem, body.joints, smooth)), found.places,
    )  # fmt: skip
    return results.estimate("smoother", body, problem.evidence, problem.timeline, beliefs)


def judged(problem: Problem, smooth: Smooth) -> Smooth:
    """The smoothed log without outliers, which hindsight finds in place of the gate of the forward pass.

    An outlier that the filter believes makes it reject the next readings. Here outliers are the readings that all
    others contradict; they are found again until they stay the same. Otherwise the gated solution is kept.
    """
    found = left_out(problem, smooth)
    removed = outliers(found)
    if problem.stepwise or not (found.gated or any(far.any() for far in removed)):
        return smooth
    for _ in range(SWEEPS):
        try:
            path = solve(without(problem, removed))
        except DidNotConverge:
            break
        found, before = left_out(problem, path), removed
        removed = outliers(found)
        if all(map(np.array_equal, removed, before)):
            return path
    return smooth


def solve(problem: Problem, warm: Solution | None = None) -> Smooth:
    """The maximum a posteriori path, first at the knots, then at all instants; or DidNotConverge."""
    knots, tangents, z, p = initial_sweep(problem, warm)
    tangents.resting, tangents.share = RESTING * LASTING, WHOLE
    first = _rounds(knots.problem, knots.fold, knots.readings, tangents, z, p, np.zeros_like(z), LASTING, warm is None)
    fold = fold_for(len(problem.timeline.t))
    lasts = np.searchsorted(knots.events, fold.lasts())
    z, p = starts(problem, fold, first, lasts)
    ends = np.zeros_like(z)
    ends[:, :-1] = knots.fold.pick(first.after, lasts).T
    # a looser tolerance, so that residues of the knots' solution do not trigger full rounds
    path = _rounds(problem, fold, full(problem, fold), tangents, z, p, ends, 2.0 * LASTING)
    return Smooth(
        fold, path.readings, tangents, path.trace, path.z, path.after,
        adjoint.covariances(path.readings, path.trace, problem.dynamics), knots=(knots, first),
    )  # fmt: skip


def _rounds(
    problem: Problem, fold: Fold, readings: Readings, tangents: Tangents, z: Array, p: Array, ends: Array,
    lasting: float, forth: bool = False,
) -> Path:  # fmt: skip
    """Rounds from starts z (K,C), p (K,K,C) and ends (K,C) until convergence; `forth`: the first one only filters."""
    tangents.write(problem, fold, readings)
    trace, back, moving, rest = None, None, np.ones(fold.count, bool), np.inf
    for sweep in range(SWEEPS):
        moving |= tangents.draw(problem, fold, readings)
        if trace is not None and back is not None and rest < lasting and not moving.any():
            return Path(fold, readings, tangents, trace, *back)
        trace = rescan(readings, problem.dynamics, z, p, moving, trace, remember=True)
        next_z, next_p = handed_over(z, p, trace.z[-1], trace.p[-1])
        moves = far(z, p, next_z, next_p)
        moving, rest = moves >= lasting, sure(float(moves.max()))
        z[:, moving], p[:, :, moving] = next_z[:, moving], next_p[:, :, moving]
        if sweep or not forth:
            back, ends, pulled = _back(readings, trace, ends, p, rest, problem.precision.order)
            rest = max(rest, pulled)
        tangents.follow(problem, fold, trace.z if back is None else back[0])
    raise DidNotConverge(f"smoother: no rest after {SWEEPS} sweeps, last move {rest:.2g}")


def _back(
    readings: Readings, trace: Trace, ends: Array, p: Array, rest: float, order: int
) -> tuple[tuple[Array, Array], Array, float]:
    """Smoothed state and adjoints (L,K,C), ends (K,C), iterated while ends move more than starts; their last move."""
    for _ in range(TURNS):
        after, at_start = adjoint.adjoints(readings, trace, ends, order)
        pulled, ends = _pulled(adjoint.before(at_start) - ends, p), adjoint.before(at_start)
        if pulled <= max(rest, LASTING):
            break
    return (adjoint.means(trace, after), after), ends, pulled


def once(problem: Problem) -> Smooth:
    """Smooth once along the filter's own tangents, as a fallback without convergence."""
    solution, k, order = walk(problem, remember=True), problem.dynamics.size, problem.precision.order
    after, _ = adjoint.adjoints(solution.readings, solution.trace, np.zeros((k, 1)), order)
    smooth = adjoint.means(solution.trace, after)
    cov = adjoint.covariances(solution.readings, solution.trace, problem.dynamics)
    return Smooth(solution.fold, solution.readings, solution.tangents, solution.trace, smooth, after, cov)


def _pulled(adjoint_moved: Array, p: Array) -> float:
    """The largest effect of moved adjoints (K,C) on a stretch's end, in standard deviations; p (K,K,C)."""
    return float(np.abs(adjoint_moved * np.sqrt(np.maximum(np.einsum("iic->ic", p), 0.0))).max())

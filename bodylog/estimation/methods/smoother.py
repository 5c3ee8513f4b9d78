"""The full-interval posterior: Gauss–Newton over the whole log; each round is a forward filter and an adjoint pass.

Linearising all frames at the smoothed angles until convergence gives the maximum a posteriori path. The backward pass
has the Bryson–Frazier form, which needs the filter's gains but no inverse.
"""

from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...settings import Estimation
from ...types import Array, Estimate, Features
from ..inference import adjoint
from ..inference.convergence import SETTLED, SWEEPS, DidNotConverge, far, sure
from ..inference.folded_readings import folded_readings
from ..inference.folds import fold_for
from ..inference.gauss_newton import initial_sweep
from ..inference.initial_path import handed_over
from ..inference.leave_one_out import Judged, free_energy, left_out, outliers, without
from ..inference.problem import Problem
from ..inference.scan import Keep, restart, scan
from ..inference.silence import smoothed
from ..inference.solution import Smooth, Solution, completed
from . import results
from .filtering import drifts, gathered, kept, lost, settled, shown, tuned, with_repairs
from .results import Beliefs


def estimate(features: Features, body: BodyModel, settings: Estimation) -> Estimate:
    """Smoothed belief at each output time, given the whole log."""
    start_problem = gathered(features, body, settings)

    def solved(problem: Problem) -> tuple[Problem, Judged]:
        problem, warm = tuned(problem, settings)
        solver = (lambda posed, _: smoothed(posed)) if problem.stepwise else solve
        problem, smooth = settled(problem, warm, settings, solver, smoothed)
        return problem, judged(problem, smooth)

    problem, smooth = kept(start_problem, solved)
    found = smooth.left_out
    unfold, m, precision = smooth.fold.unfold, len(problem.start), problem.precision
    z, cov = unfold(smooth.z), precision.of(unfold(smooth.cov)[:, :m, :m], problem.held)
    cov = with_repairs(cov, problem, smooth)
    errors = np.full((*problem.timeline.t.shape, m), np.nan)
    errors[problem.timeline.encoders] = found.encoders
    beliefs = Beliefs(
        shown(z, problem), cov, free_energy(problem, smooth, found), z[:, :m], cov, errors,
        precision.scale, precision.plain(), drifts(problem, smooth),
        tuple(lost(problem, body.joints, smooth)), found.places,
    )  # fmt: skip
    made = results.estimate("smoother", body, problem.evidence, problem.timeline, beliefs)
    return results.with_lasting_error(made, problem, beliefs.z, settings)


def judged(problem: Problem, smooth: Smooth) -> Judged:
    """The smoothed log without outliers, which hindsight finds in place of the gate of the forward pass.

    An outlier that the filter believes makes it reject the next readings. Here outliers are the readings that all
    others contradict; they are found again until they stay the same. Otherwise the gated solution is kept.
    """
    gated = Judged.of(smooth, left_out(problem, smooth))
    found, removed = gated.left_out, outliers(gated.left_out)
    if problem.stepwise or not (found.gated or any(far.any() for far in removed)):
        return gated
    path: Smooth = smooth
    for _ in range(SWEEPS):
        try:
            path = solve(replace(without(problem, removed), gate=np.inf), path)
        except DidNotConverge:
            break
        found, before = left_out(problem, path), removed
        removed = outliers(found)
        if all(map(np.array_equal, removed, before)):
            return Judged.of(path, found)
    return gated


def solve(problem: Problem, warm: Solution | None = None) -> Smooth:
    """The maximum a posteriori path; or DidNotConverge. Without a smoothed log `warm` the first round only filters.

    Rounds end when a stretch's start and end, in standard deviations, and points, in rad, move by less than the root of
    SETTLED: a tangent is off by the square of its point's error. The paths of 19 logs are then within 5e-4 standard
    deviations of the fixed point.
    """
    lasting, fold, dynamics = SETTLED**0.5, fold_for(len(problem.timeline.t)), problem.dynamics
    tangents, z, p = initial_sweep(problem, fold, warm)
    tangents.resting, tangents.whole = lasting, True
    readings, trace, rest = folded_readings(problem, fold), None, np.inf
    ends, beyond = np.zeros((2, *z.shape))  # adjoints by all later readings, and by those far from a stretch's start
    tangents.write(problem, fold, readings)
    for sweep in range(SWEEPS):
        moved = tangents.draw(problem, fold, readings)
        if trace is None or moved:
            trace = scan(readings, dynamics, z, p, Keep.MEANS, into=trace)
        else:
            restart(readings, dynamics, z, p, trace)
        next_z, next_p = handed_over(z, p, trace.z[-1], trace.end_p)
        z, p, move, path = next_z, next_p, sure(far(z, p, next_z, next_p)), trace.z
        if sweep or isinstance(warm, Smooth):
            near = adjoint.at_start(readings, trace, dynamics)
            expected = adjoint.before(near + beyond)
            if not moved and max(rest, move, _pulled(expected - ends, p)) < lasting:
                return completed(fold, readings, tangents, trace, expected, dynamics)
            path, at_start = adjoint.smoothed(readings, trace, expected, dynamics)
            ends, beyond = adjoint.before(at_start), at_start - near
            rest = _pulled(ends - expected, p)
        tangents.follow(problem, fold, path)
    raise DidNotConverge(f"smoother: no rest after {SWEEPS} sweeps, last move {move:.2g}")


def _pulled(adjoint_moved: Array, p: Array) -> float:
    """How far moved adjoints (K,C) move ends, in standard deviations, of covariance p (K,K,C) at the next start."""
    moved = np.einsum("abc,bc->ac", p[..., 1:], adjoint_moved[:, :-1])
    return float(np.abs(moved / np.sqrt(np.maximum(np.einsum("aac->ac", p[..., 1:]), 1e-24))).max(initial=0.0))

"""The full-interval posterior: Gauss–Newton over the whole
log; each round is a forward filter and an adjoint pass.

Linearising all frames at the smoothed angles until convergence gives the maximum a posteriori path.
The backward pass has the Bryson–Frazier form, which needs the filter's gains but no inverse.
"""

from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...settings import EstimationSettings
from ...types import Estimate, Features
from ..inference.convergence import CONVERGED_MOVE, MAX_SWEEPS, DidNotConverge, require_finite
from ..inference.folds import Fold, fold_readings
from ..inference.gauss_newton import begin_tangents
from ..inference.leave_one_out import (
    SmoothedWithResiduals,
    find_contradicted_readings,
    predict_left_out,
    remove_readings,
    smoothed_free_energy,
)
from ..inference.problem import FilterProblem
from ..inference.scan import TraceDetail, filter_stretches
from ..inference.silence import smooth_across_silence
from ..inference.solution import Smooth, Solution, assemble_smooth, smooth_states
from ..inference.tangents import stretch_priors
from .explained import explained_estimate
from .filtering import (
    build_filter_problem,
    find_offset_faults,
    select_reported_states,
    solve_with_offsets,
    solve_with_reacquisition,
    tune_noise,
    warn_of_lost_belief,
    with_repairs,
)
from .results import Beliefs


def estimate_by_smoother(
    features: Features, body: BodyModel, settings: EstimationSettings
) -> Estimate:
    """Smoothed belief at each output time, given the whole log."""
    start_problem = build_filter_problem(features, body, settings)

    def solved(problem: FilterProblem) -> tuple[FilterProblem, SmoothedWithResiduals]:
        problem, warm = tune_noise(problem, settings)
        solver = (
            (lambda posed, _: smooth_across_silence(posed)) if problem.stepwise else solve_map_path
        )
        problem, smooth = solve_with_offsets(problem, warm, settings, solver, smooth_across_silence)
        return problem, remove_outliers(problem, smooth)

    problem, smooth = solve_with_reacquisition(start_problem, solved)
    found = smooth.left_out
    unfold = smooth.fold.unfold
    m = len(problem.start)
    precision = problem.precision
    z = unfold(smooth.z)
    cov = precision.of(unfold(smooth.cov)[:, :m, :m], problem.held)
    cov = with_repairs(cov, problem, smooth)
    errors = np.full((*problem.timeline.t.shape, m), np.nan)
    errors[problem.timeline.encoders] = found.encoders
    beliefs = Beliefs(
        select_reported_states(z, problem),
        cov,
        smoothed_free_energy(problem, smooth, found),
        z[:, :m],
        cov,
        errors,
        precision.scale,
        precision.plain(),
        find_offset_faults(problem, smooth),
        tuple(warn_of_lost_belief(problem, body.joints, smooth)),
        found.places,
    )
    return explained_estimate("smoother", body, problem, start_problem, beliefs, settings)


def remove_outliers(problem: FilterProblem, smooth: Smooth) -> SmoothedWithResiduals:
    """The smoothed log without outliers, which hindsight
    finds in place of the gate of the forward pass.

    An outlier that the filter believes makes it reject the next readings. Here outliers are the
    readings that all others contradict; they are found again until they stay the same. Otherwise
    the gated solution is kept.
    """
    gated = SmoothedWithResiduals.of(smooth, predict_left_out(problem, smooth))
    found = gated.left_out
    removed = find_contradicted_readings(gated.left_out)
    if problem.stepwise or not (found.gated or any(far.any() for far in removed)):
        return gated
    path: Smooth = smooth
    for _ in range(MAX_SWEEPS):
        try:
            path = solve_map_path(replace(remove_readings(problem, removed), gate=np.inf), path)
        except DidNotConverge:
            break
        found = predict_left_out(problem, path)
        before = removed
        removed = find_contradicted_readings(found)
        if all(map(np.array_equal, removed, before)):
            return SmoothedWithResiduals.of(path, found)
    return gated


def solve_map_path(problem: FilterProblem, warm: Solution | None = None) -> Smooth:
    """The maximum a posteriori path; or DidNotConverge.
    Without a smoothed log `warm` the first round only filters.

    Rounds end when points move by less than the root of CONVERGED_MOVE, in rad: a tangent is off by
    the square of its point's error. The paths of 19 logs are then within 5e-4 standard deviations
    of the fixed point.
    """
    fold = Fold.of(problem)
    dynamics = problem.dynamics
    tangents = begin_tangents(problem, warm)
    tangents.resting = CONVERGED_MOVE**0.5
    tangents.whole = True
    readings = fold_readings(problem, fold)
    start = stretch_priors(problem, fold)
    trace = None
    smoothed = False
    tangents.write(problem, fold, readings)
    for sweep in range(MAX_SWEEPS):
        moved = tangents.draw(problem, fold, readings)
        if trace is None or moved:
            trace = filter_stretches(readings, dynamics, *start, TraceDetail.MEANS, into=trace)
            require_finite(trace.nats)
        elif smoothed:
            return assemble_smooth(fold, readings, tangents, trace, dynamics)
        smoothed = sweep > 0 or isinstance(warm, Smooth)
        path = smooth_states(readings, trace, dynamics)[0] if smoothed else trace.z
        tangents.follow(problem, fold, path)
    raise DidNotConverge(f"smoother: no rest after {MAX_SWEEPS} sweeps")

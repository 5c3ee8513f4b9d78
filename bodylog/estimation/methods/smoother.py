"""The full-interval posterior: Gauss–Newton over the whole log; each round is a forward filter and
an adjoint pass.

Linearising all frames at the smoothed angles until convergence gives the maximum a posteriori path.
The backward pass has the Bryson–Frazier form, which needs the filter's gains but no inverse.
"""

from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...settings import EstimationSettings
from ...types import Capabilities, Estimate, Features
from ..inference.filter_log import begin_sweeps, sweep_log
from ..inference.filter_pass import CONVERGED_MOVE, MAX_SWEEPS, DidNotConverge, TraceDetail
from ..inference.filter_problem import FilterProblem
from ..inference.leave_one_out import (
    SmoothedWithResiduals,
    compute_smoothed_free_energy,
    find_contradicted_readings,
    predict_left_out,
    remove_readings,
)
from ..inference.silence import smooth_across_silence
from ..inference.solution import Smooth, Solution, assemble_smooth, smooth_states
from .contract import Method
from .explained import estimate_with_hardware_errors
from .filtering import (
    build_filter_problem,
    find_offset_faults,
    leave_out_stray_runs,
    report_angle_covariance,
    select_reported_states,
    solve_with_offsets,
    solve_with_reacquisition,
    tune_noise,
    warn_of_lost_belief,
)
from .results import Beliefs
from .slip_estimates import estimate_evident_slips


def estimate_by_smoother(
    features: Features, body: BodyModel, settings: EstimationSettings
) -> Estimate:
    """Smoothed belief at each output time, given the whole log."""
    built = build_filter_problem(features, body, settings)
    slipping = estimate_evident_slips(built, settings)
    if slipping is not None:
        return slipping
    start_problem = leave_out_stray_runs(built, settings)
    problem, beliefs = _smooth_log(start_problem, settings)
    return estimate_with_hardware_errors(body, problem, start_problem, beliefs, settings)


def _smooth_log(
    start_problem: FilterProblem, settings: EstimationSettings
) -> tuple[FilterProblem, Beliefs]:
    """The smoothed beliefs; what they are made of, most of a log's memory, ends here."""

    def solve_problem(problem: FilterProblem) -> tuple[FilterProblem, SmoothedWithResiduals]:
        problem, warm = tune_noise(problem, settings)
        solver = None if problem.stepwise else solve_map_path
        problem, smooth = solve_with_offsets(problem, warm, settings, solver, smooth_across_silence)
        return problem, remove_outliers(problem, smooth)

    problem, smooth = solve_with_reacquisition(start_problem, solve_problem)
    found = smooth.left_out
    m = len(problem.start)
    precision = problem.precision
    z = smooth.z
    cov = report_angle_covariance(smooth.cov[:, :m, :m], problem, smooth)
    errors = np.full((*problem.timeline.t.shape, m), np.nan)
    errors[problem.timeline.encoders] = found.encoders
    beliefs = Beliefs(
        z=select_reported_states(z, problem),
        cov=cov,
        nats=compute_smoothed_free_energy(problem, smooth, found),
        before=z[:, :m],
        before_cov=cov,
        encoder_errors=errors,
        scale=precision.scale,
        settings=precision.plain_numbers(),
        faults=find_offset_faults(problem, smooth),
        findings=warn_of_lost_belief(problem, smooth),
        places=found.places,
    )
    return problem, beliefs


def remove_outliers(problem: FilterProblem, smooth: Smooth) -> SmoothedWithResiduals:
    """The smoothed log without outliers, which hindsight
    finds in place of the gate of the forward pass.

    An outlier that the filter believes makes it reject the next readings. Here outliers are the
    readings that all others contradict; they are found again until they stay the same. Otherwise
    the gated solution is kept.
    """
    gated = SmoothedWithResiduals(**vars(smooth), left_out=predict_left_out(problem, smooth))
    found = gated.left_out
    removed = find_contradicted_readings(gated.left_out)
    if problem.stepwise or not (found.gated or any(far.any() for far in removed)):
        return gated
    warm: Smooth = gated
    for _ in range(MAX_SWEEPS):
        try:
            path = solve_map_path(replace(remove_readings(problem, removed), gate=np.inf), warm)
        except DidNotConverge:
            break
        found = predict_left_out(problem, path)
        before = removed
        removed = find_contradicted_readings(found)
        if all(map(np.array_equal, removed, before)):
            return SmoothedWithResiduals(**vars(path), left_out=found)
        warm = replace(gated, tangents=path.tangents)
        del path, found  # most of a log's memory, before as much is needed again
    return gated


def solve_map_path(problem: FilterProblem, warm: Solution | None = None) -> Smooth:
    """The maximum a posteriori path; or DidNotConverge. Without a smoothed log `warm` the first
    round only filters.

    Rounds end when points move by less than the root of CONVERGED_MOVE, in rad: a tangent is off by
    the square of its point's error.
    """
    readings, tangents = begin_sweeps(problem, warm, CONVERGED_MOVE**0.5, whole=True)
    trace = None
    smoothed = isinstance(warm, Smooth)
    for _ in range(MAX_SWEEPS):
        moved = tangents.write_stale_tangents(problem, readings)
        if trace is not None and smoothed and not moved:
            return assemble_smooth(readings, tangents, trace, problem.dynamics)
        trace = sweep_log(problem, readings, TraceDetail.MEANS, trace)
        path = trace.z
        if smoothed:
            path, _ = smooth_states(readings, trace, problem.dynamics)
        tangents.move_points(problem, path)
        smoothed = True
    raise DidNotConverge(f"smoother: no rest after {MAX_SWEEPS} sweeps")


METHODS = {"smoother": Method(estimate_by_smoother, Capabilities(causal=False))}

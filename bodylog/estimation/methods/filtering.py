"""The filter methods: set up the problem, solve it,
look for encoder offsets, and return the beliefs.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from ...body_model import BodyModel
from ...errors import UsageError
from ...motion import MAX_ORDER, PROCESS_UNITS
from ...settings import EstimationSettings
from ...types import Array, Capabilities, Estimate, Fault, Features, Finding
from ..faults import encoder_offset, offset_changes
from ..faults.screening import screen_measurements
from ..faults.stray_images import StrayRun, find_stray_runs, list_possible_runs, remove_stray_runs
from ..inference.filter_log import (
    filter_roughly,
    filter_sequentially,
    find_initial_path,
    loses_encoder,
    solve_by_gauss_newton,
)
from ..inference.filter_pass import DidNotConverge
from ..inference.filter_problem import FilterProblem
from ..inference.reacquisition import warn_of_resets
from ..inference.solution import Solution
from ..measurements.gather import choose_initial_angles
from ..measurements.timeline import build_timeline
from ..noise import encoder_noise, noise_model
from ..noise.evidence_search import tune_by_evidence, with_motion, with_preferred_order
from ..noise.noise_model import resolve_noise_model, warn_of_few_readings, weigh_repeated_readings
from ..noise.posture_prior import learn_posture_prior
from .contract import Method
from .explained import estimate_with_hardware_errors
from .results import Beliefs
from .slip_estimates import estimate_evident_slips

S = TypeVar("S", bound=Solution)


def estimate_by_filter(
    features: Features, body: BodyModel, settings: EstimationSettings
) -> Estimate:
    """Filtered belief at each output time, given all measurements up to then.

    `filter` linearises frames at the belief until it
    converges; `ekf` does so once, at the prior mean.
    """
    built = build_filter_problem(features, body, settings)
    slipping = estimate_evident_slips(built, settings)
    if slipping is not None:
        return slipping
    start_problem = leave_out_stray_runs(built, settings)

    def solve_problem(problem: FilterProblem) -> tuple[FilterProblem, Solution]:
        problem, warm = tune_noise(problem, settings)
        solver: Callable[[FilterProblem, Solution | None], Solution] | None
        if settings.method == "ekf":
            solver = partial(solve_by_gauss_newton, at="prior")
        else:
            solver = None if problem.stepwise else solve_by_gauss_newton
        return solve_with_offsets(problem, warm, settings, solver, filter_sequentially)

    problem, solution = solve_with_reacquisition(start_problem, solve_problem)
    trace = solution.trace
    m = len(problem.start)
    precision = problem.precision
    beliefs = Beliefs(
        z=select_reported_states(trace.z, problem),
        cov=report_angle_covariance(trace.cov[:, :m, :m], problem, solution),
        nats=trace.nats,
        before=trace.prior,
        before_cov=trace.prior_cov,
        encoder_errors=trace.encoder_d,
        scale=precision.scale,
        settings=precision.plain_numbers(),
        faults=find_offset_faults(problem, solution),
        findings=warn_of_lost_belief(problem, solution),
    )
    return estimate_with_hardware_errors(body, problem, start_problem, beliefs, settings)


def leave_out_stray_runs(built: FilterProblem, settings: EstimationSettings) -> FilterProblem:
    """The problem without runs of images of something else, where noise is by evidence: what a run
    costs is judged by it.
    """
    if settings.precision != "auto" or built.stepwise:
        return built
    problem = built
    runs = list[StrayRun]()
    while possible := list_possible_runs(problem):
        more = find_stray_runs(tune_noise(problem, settings)[0], possible)
        if not more:
            break
        runs += more
        problem = remove_stray_runs(built, runs)
    return problem


def build_filter_problem(
    features: Features, body: BodyModel, settings: EstimationSettings
) -> FilterProblem:
    """The problem with the encoders' noise model."""
    evidence = warn_of_few_readings(screen_measurements(features, body, settings), body, settings)
    sightings = noise_model.with_typed_variances(evidence.sightings, settings)
    evidence = replace(evidence, sightings=sightings)
    start = choose_initial_angles(evidence, settings)
    precision = noise_model.with_typed_noise(
        resolve_noise_model(evidence, body, settings), settings, body.joints
    )
    findings = noise_model.remark_on_precision(settings, precision, evidence.sightings)
    evidence = replace(evidence, findings=(*evidence.findings, *findings))
    evidence = weigh_repeated_readings(evidence, precision, settings)
    prior = learn_posture_prior(evidence, precision.process, start)
    timeline = build_timeline(evidence, settings.rate)
    problem = FilterProblem(evidence, timeline, start, precision, posture_prior=prior)
    walks = encoder_offset.choose_preset_walks(settings.bias, evidence)
    if walks is not None:
        problem = offset_changes.with_drift(problem, walks)
    if settings.motion != "auto":
        problem = with_named_motion(problem, settings)
    elif settings.process is None:  # it is a white acceleration
        problem = with_preferred_order(problem)
    precision = noise_model.with_typed_noise(problem.precision, settings, body.joints)
    return find_initial_path(replace(problem, precision=precision))


def with_named_motion(problem: FilterProblem, settings: EstimationSettings) -> FilterProblem:
    """The problem with the motion model that is set; UsageError where nothing gives its noise."""
    problem = with_motion(problem, settings.motion)
    precision = problem.precision
    unread = problem.posture_prior is not None
    unknown = settings.process is None and (unread or precision.learned is None)
    if unknown and precision.order == MAX_ORDER:
        raise UsageError(
            f"motion: {settings.motion!r} needs process noise in {PROCESS_UNITS[MAX_ORDER]}, "
            "which neither the body nor this log gives; set process under [estimate]"
        )
    if not unread:
        return problem
    typed = noise_model.with_typed_noise(precision, settings, problem.evidence.joints)
    prior = learn_posture_prior(problem.evidence, typed.process, problem.start, typed.order)
    return replace(problem, posture_prior=prior)


def solve_with_reacquisition(
    problem: FilterProblem, solve: Callable[[FilterProblem], tuple[FilterProblem, S]]
) -> tuple[FilterProblem, S]:
    """The problem as solved and its solution, with
    re-acquisition if the belief loses an encoder for long.
    """
    found, solution = solve(problem)
    if found.stepwise or not loses_encoder(found, solution):
        return found, solution
    return solve(find_initial_path(problem, lost=True))


def tune_noise(
    problem: FilterProblem, settings: EstimationSettings
) -> tuple[FilterProblem, Solution | None]:
    """The problem with process and pixel noise by the log's evidence, if settings ask for that."""
    if settings.precision != "auto":
        return problem, None
    found, warm = tune_by_evidence(problem, whole=settings.method == "smoother")
    # variances that are set replace learned ones afterwards
    return replace(
        problem, precision=noise_model.with_typed_noise(found, settings, problem.evidence.joints)
    ), warm


def solve_with_offsets(
    problem: FilterProblem,
    warm: Solution | None,
    settings: EstimationSettings,
    solver: Callable[[FilterProblem, Solution | None], S] | None,
    fallback: Callable[[FilterProblem], S],
) -> tuple[FilterProblem, S]:
    """Solve the problem, with encoder offsets if the
    settings allow them and the evidence asks for them.

    warm: a solution to start from · fallback, slower but robust, takes over if there is no solver,
    or if it does not converge. Returns the problem that was solved, which holds the offsets, and
    its solution.
    """

    def solve_or_fall_back(posed: FilterProblem, begin: Solution | None) -> S:
        if solver is not None:
            with suppress(DidNotConverge):
                return solver(posed, begin)
        return fallback(posed)

    solution = solve_or_fall_back(problem, warm)
    if settings.bias != "auto" or problem.evidence.encoders is None:
        return problem, solution
    if problem.is_undetermined():  # images contradict no encoder
        return problem, solution
    scored, suspected = encoder_offset.find_suspected_encoders(problem, solution)
    if not suspected.any():
        return scored, solution
    if not problem.stepwise and loses_encoder(problem, filter_roughly(problem, solution)):
        # a filter that is lost makes offsets of sound readings: with re-acquisition first
        again, begin = tune_noise(find_initial_path(problem, lost=True), settings)
        return solve_with_offsets(again, begin, settings, None, fallback)
    with_offsets = encoder_offset.choose_encoder_offsets(
        scored, solution, suspected, lambda posed: relearn_noise(posed, settings)[0]
    )
    if not with_offsets.alternatives:
        return with_offsets, solution
    relearned, begin = relearn_noise(with_offsets, settings)
    return relearned, solve_or_fall_back(relearned, begin)


def relearn_noise(
    problem: FilterProblem, settings: EstimationSettings
) -> tuple[FilterProblem, Solution | None]:
    """The problem with noise learned again, first from the
    encoders: the process noise had absorbed the offset.
    """
    encoders = problem.evidence.encoders
    precision = problem.precision
    if precision.learned is None or encoders is None:
        return tune_noise(problem, settings)
    known = precision.learned[precision.order - 2].dithered
    joints = encoder_noise.average_joint_readings(encoders)
    evident = encoder_noise.learn_encoder_noise(
        joints, precision.encoder, precision.process, precision.order, known
    ).process
    held = noise_model.with_typed_noise(
        precision.with_memory_bound(evident, encoders), settings, problem.evidence.joints
    )
    return tune_noise(replace(problem, precision=held), settings)


def select_reported_states(z: Array, problem: FilterProblem) -> Array:
    """Angles, rates and, if there are any, offsets (E,·) of states z (E,K)."""
    m = len(problem.start)
    offsets = problem.dynamics.order * m
    return np.concatenate([z[:, : 2 * m], z[:, offsets:]], axis=1)


def warn_of_lost_belief(problem: FilterProblem, solved: Solution) -> tuple[Finding, ...]:
    """A warning where the belief was reset."""
    resets = solved.readings.reset
    if resets is None:
        return ()
    names = problem.evidence.joints
    return tuple(warn_of_resets(names, problem.timeline.t, resets))


def read_offset_variance(problem: FilterProblem, solved: Solution) -> Array:
    """Variances (E,M) rad² of the encoder offsets in the filter's state."""
    m = len(problem.start)
    return np.asarray(np.einsum("eii->ei", solved.trace.cov[:, m:, m:]))


def report_angle_covariance(cov: Array, problem: FilterProblem, solved: Solution) -> Array:
    """Covariances (E,M,M) rad² of angles as the noise model states them, and the variance that
    repaired jumps add.
    """
    cov = problem.precision.stated_covariance(cov, problem.left_open)
    drifts = problem.precision.drift is not None
    offset_var = read_offset_variance(problem, solved) if drifts else None
    added = encoder_offset.measure_repair_variance(problem, offset_var)
    return np.asarray(cov + added[:, :, None] * np.eye(added.shape[1]))


def find_offset_faults(problem: FilterProblem, solved: Solution) -> tuple[Fault, ...]:
    """Encoder offsets as faults, from the filtered offsets, without encoders known to be faulty."""
    if problem.precision.drift is None:
        return ()
    var = read_offset_variance(problem, solved)
    offsets = solved.trace.z[:, problem.dynamics.offset :]
    return encoder_offset.list_drifting_encoders(problem, offsets, var)


METHODS = {
    "filter": Method(estimate_by_filter, Capabilities(), live=True),
    "ekf": Method(estimate_by_filter, Capabilities()),
}

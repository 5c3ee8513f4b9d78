"""The filter methods: set up the problem, solve it, look for encoder offsets, and return the beliefs."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from ...body_model import BodyModel
from ...settings import Estimation
from ...types import Array, Estimate, Fault, Features, Finding
from ..faults import encoder_offset
from ..faults.offset_step import free_energy
from ..faults.screening import screened
from ..inference.convergence import DidNotConverge
from ..inference.gauss_newton import solve
from ..inference.problem import Problem
from ..inference.reacquisition import named
from ..inference.solution import Solution
from ..inference.walk import filtered, find_initial_path, loses_encoder, walk
from ..measurements.gather import start
from ..measurements.timeline import timeline
from ..noise import encoder_noise, typed
from ..noise.evidence_search import tune, with_preferred_order
from ..noise.noise_model import resolve, warned, weighed
from ..noise.posture_prior import learn_prior
from . import results
from .results import Beliefs

S = TypeVar("S", bound=Solution)


def estimate(features: Features, body: BodyModel, settings: Estimation) -> Estimate:
    """Filtered belief at each output time, given all measurements up to then.

    `laplace` linearises frames at the belief until it converges; `ekf` does so once, at the prior mean.
    """
    at = "prior" if settings.method == "ekf" else "posterior"
    start_problem = gathered(features, body, settings)

    def solved(problem: Problem) -> tuple[Problem, Solution]:
        problem, warm = tuned(problem, settings)
        stepwise = at == "posterior" and problem.stepwise
        solver = (lambda posed, _: walk(posed)) if stepwise else partial(solve, at=at)
        return settled(problem, warm, settings, solver, walk)

    problem, solution = kept(start_problem, solved)
    trace, unfold, m = solution.trace, solution.fold.unfold, len(problem.start)
    precision = problem.precision
    beliefs = Beliefs(
        shown(unfold(trace.z), problem),
        with_repairs(precision.of(unfold(trace.cov[:, :m, :m]), problem.held), problem, solution), unfold(trace.nats),
        unfold(trace.prior),
        unfold(trace.prior_cov), unfold(trace.encoder_d), precision.scale, precision.plain(),
        drifts(problem, solution), tuple(lost(problem, body.joints, solution)),
    )  # fmt: skip
    found = results.estimate(settings.method, body, problem.evidence, problem.timeline, beliefs)
    return results.with_lasting_error(found, problem, beliefs.z, settings)


def gathered(features: Features, body: BodyModel, settings: Estimation) -> Problem:
    """The problem with the encoders' noise model."""
    evidence = warned(screened(features, body, settings), body, settings)
    evidence = replace(evidence, sightings=typed.sightings(evidence.sightings, settings))
    first = start(evidence, settings, body.joints)
    precision = typed.precision(resolve(evidence, body, settings), settings, body.joints)
    evidence = replace(evidence, findings=(*evidence.findings, *typed.remark(settings, precision, evidence.sightings)))
    evidence = weighed(evidence, precision, settings)
    usual = learn_prior(evidence, precision.process, first)
    problem = Problem(evidence, timeline(evidence, settings.rate), first, precision, posture_prior=usual)
    allowed = encoder_offset.preset_walks(settings.bias, evidence)
    problem = problem if allowed is None else encoder_offset.with_drift(problem, allowed)
    if settings.process is None:  # it is a white acceleration
        problem = with_preferred_order(problem)
        problem = replace(problem, precision=typed.precision(problem.precision, settings, body.joints))
    return find_initial_path(problem)


def kept(problem: Problem, solved: Callable[[Problem], tuple[Problem, S]]) -> tuple[Problem, S]:
    """The problem as `solved`, and solved again with re-acquisition if the belief loses an encoder for long."""
    found, solution = solved(problem)
    if found.stepwise or not loses_encoder(found, solution):
        return found, solution
    return solved(find_initial_path(problem, lost=True))


def tuned(problem: Problem, settings: Estimation) -> tuple[Problem, Solution | None]:
    """The problem with process and pixel noise by the log's evidence, if the settings ask for that."""
    if settings.precision != "auto":
        return problem, None
    found, warm = tune(problem, whole=settings.method == "smoother")
    # variances that are set replace learned ones afterwards
    return replace(problem, precision=typed.precision(found, settings, problem.evidence.joints)), warm


def settled(
    problem: Problem, warm: Solution | None, settings: Estimation,
    solver: Callable[[Problem, Solution | None], S], patient: Callable[[Problem], S],
) -> tuple[Problem, S]:  # fmt: skip
    """Solve the problem, with encoder offsets if the settings allow them and the evidence asks for them.

    `patient`, slower but robust, takes over if the solver does not converge.
    """

    def sure(posed: Problem, begin: Solution | None) -> S:
        try:
            return solver(posed, begin)
        except DidNotConverge:
            return patient(posed)

    solved = sure(problem, warm)
    if settings.bias != "auto" or problem.evidence.encoders is None:
        return problem, solved
    found, suspected = encoder_offset.suspected_encoders(problem, solved)
    if suspected.any() and not problem.stepwise and loses_encoder(problem, filtered(problem, solved)):
        # a filter that is lost makes offsets of sound readings: with re-acquisition first
        again, begin = tuned(find_initial_path(problem, lost=True), settings)
        return settled(again, begin, settings, lambda posed, _: patient(posed), patient)
    if suspected.any():
        known = partial(cost, warm=solved)
        found = encoder_offset.choose(found, solved, suspected, known, lambda posed: retuned(posed, settings)[0])
    if not found.alternatives:
        return found, solved
    found, begin = retuned(found, settings)
    return found, sure(found, begin)


def retuned(problem: Problem, settings: Estimation) -> tuple[Problem, Solution | None]:
    """The problem with noise learned again, first from the encoders: the process noise had absorbed the offset."""
    encoders, precision = problem.evidence.encoders, problem.precision
    if precision.learned is None or encoders is None:
        return tuned(problem, settings)
    known = precision.learned[precision.order - 2].dithered
    joints = encoder_noise.series(encoders)
    evident = encoder_noise.learn(joints, precision.encoder, precision.process, precision.order, known).process
    held = typed.precision(precision.held(evident, encoders), settings, problem.evidence.joints)
    return tuned(replace(problem, precision=held), settings)


def cost(problem: Problem, warm: Solution | None = None) -> float:
    """Free energy (nats) of the whole log, filtered from where `warm` ended."""
    return free_energy(filtered(problem, warm))


def shown(z: Array, problem: Problem) -> Array:
    """Angles, rates and, if there are any, offsets (E,·) of states z (E,K)."""
    m, size = len(problem.start), problem.dynamics.order * len(problem.start)
    return np.concatenate([z[:, : 2 * m], z[:, size:]], axis=1)


def lost(problem: Problem, names: tuple[str, ...], solved: Solution) -> Iterator[Finding]:
    """A warning where the belief was reset."""
    resets = solved.readings.reset
    return iter(()) if resets is None else named(names, problem.timeline.t, solved.fold.unfold(resets))


def offset_variance(problem: Problem, solved: Solution) -> Array:
    """Variances (E,M) rad² of the encoder offsets in the filter's state."""
    m = len(problem.start)
    return np.asarray(solved.fold.unfold(np.einsum("liic->lic", solved.trace.cov[:, m:, m:])))


def with_repairs(cov: Array, problem: Problem, solved: Solution) -> Array:
    """Covariances (E,M,M) rad² of angles with what the repair of jumps adds."""
    offset_var = None if problem.precision.drift is None else offset_variance(problem, solved)
    added = encoder_offset.repaired_variance(problem, offset_var)
    return np.asarray(cov + added[:, :, None] * np.eye(added.shape[1]))


def drifts(problem: Problem, solved: Solution) -> tuple[Fault, ...]:
    """Encoder offsets as faults, from the filtered offsets, without encoders known to be faulty."""
    if problem.precision.drift is None:
        return ()
    unfold = solved.fold.unfold
    var = offset_variance(problem, solved)
    offsets = unfold(solved.trace.z[:, problem.dynamics.offset :])
    return encoder_offset.faults(problem, offsets, var)

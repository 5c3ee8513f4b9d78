"""The filters as methods: pose the log as a problem, solve it, write the beliefs down."""

from dataclasses import replace

import numpy as np

from ..settings import Estimation
from ..types import BodyModel, Estimate, Fault, Features, Finding
from . import results
from .laplace import Problem, solve
from .precision import resolve
from .results import Beliefs
from .senses import gather, start
from .timeline import timeline
from .tuning import tune


def laplace(features: Features, body: BodyModel, settings: Estimation) -> Estimate:
    """Filtered belief: at each output time, all that was heard until then."""
    return _estimate(features, body, settings, "laplace", "posterior")


def ekf(features: Features, body: BodyModel, settings: Estimation) -> Estimate:
    """The plain extended Kalman filter: the same, but frames are linearised once, at the prior mean."""
    return _estimate(features, body, settings, "ekf", "prior")


def _estimate(features: Features, body: BodyModel, settings: Estimation, method: str, at: str) -> Estimate:
    problem, faults, findings = pose(features, body, settings)
    solution = solve(problem, at=at)
    trace, unfold, m = solution.trace, solution.fold.unfold, len(problem.start)
    beliefs = Beliefs(
        unfold(trace.z), unfold(trace.p[:, :m, :m]), unfold(trace.nats), unfold(trace.prior), unfold(trace.prior_cov),
        unfold(trace.encoder_d), problem.precision.scale, problem.precision.plain(), faults, findings,
    )  # fmt: skip
    return results.estimate(method, body, problem.evidence, problem.timeline, beliefs)


def pose(
    features: Features, body: BodyModel, settings: Estimation
) -> tuple[Problem, tuple[Fault, ...], tuple[Finding, ...]]:
    """The log as a problem to be filtered, with precisions resolved, and what was noticed on the way."""
    evidence = gather(features, body, settings)
    first = start(evidence, settings, len(body.joints))
    precision = resolve(evidence, body, settings)
    problem = Problem(evidence, timeline(evidence, settings.rate), first, precision)
    if settings.precision == "auto":
        tuned = tune(problem)
        # white acceleration fits no motion at all time scales: filtering takes the middle of encoders' and frames'
        between = np.sqrt(precision.process * tuned.process) if settings.method != "smoother" else tuned.process
        problem = replace(problem, precision=replace(tuned, process=between))
    return problem, (), ()

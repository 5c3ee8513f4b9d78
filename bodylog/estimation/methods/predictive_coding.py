"""The paper's Algorithm 1 (`algorithm1`) on a log: one
Euler step per instant, explicit as printed or implicit.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from ...body_model import BodyModel
from ...errors import UsageError
from ...settings import EstimationSettings
from ...types import Array, Capabilities, Estimate, Features, Finding
from ..measurements.gather import list_unread_joints
from ..measurements.records import Evidence
from ..noise.noise_model import PAPER_VARIANCES
from . import results
from .algorithm1 import (
    DIVERGENCE_RAD,
    CodingDynamics,
    SensedErrors,
    build_gauss_newton_hessian,
    descend_free_energy,
    measure_stable_step,
)
from .contract import Method
from .grid import TRIED_GAINS, GridProblem, build_grid_problem, hold_beliefs_at_instants


def estimate_by_predictive_coding(
    features: Features, body: BodyModel, settings: EstimationSettings
) -> Estimate:
    """The belief on a grid of 20 Hz or `rate`; UsageError when an explicit step diverges."""
    problem, evidence, line = build_grid_problem(features, body, settings)
    explicit = settings.step == "explicit" or settings.preset == "paper"
    x, cov, nats = integrate_belief(problem, explicit)
    findings = warn_of_unstable_step(problem) if explicit else ()
    if not np.isfinite(x).all():
        why = findings[0].text if findings else "step: explicit; type --step implicit"
        raise UsageError(f"{why} (the belief left {DIVERGENCE_RAD:g} rad)")
    findings = (*findings, *_warn_of_unread_joints(problem, evidence))
    steps = {
        "step": "explicit" if explicit else "implicit",
        "dt": problem.dt,
        "sigma_x": problem.sigma_x.tolist(),
    }
    used = steps | {f"sigma_{s.name}": np.median(s.sigma, axis=0).tolist() for s in problem.senses}
    moved = np.maximum(np.einsum("nii->ni", cov), problem.moved)[:, :, None] * np.eye(x.shape[1])
    beliefs = hold_beliefs_at_instants(
        line, evidence, problem.encoders, x, cov, moved, nats, used, findings
    )
    return results.build_estimate("predictive-coding", evidence, line, beliefs)


def integrate_belief(problem: GridProblem, explicit: bool) -> tuple[Array, Array, Array]:
    """x (N,M), NaN once diverged, covariance (N,M,M) as inverse
    Hessian, and free energy (N,) nats before each step.
    """
    m = len(problem.start)
    n = len(problem.t)
    xs = np.full((n, m), np.nan)
    cov = np.full((n, m, m), np.nan)
    nats = np.full(n, np.nan)
    kind = np.array([not explicit])
    dynamics = CodingDynamics(
        problem.dt, problem.sigma_x[None], np.array([problem.learning]), at_rest=kind, implicit=kind
    )
    start = problem.start[None]
    for k, step in enumerate(
        descend_free_energy(start, start, n, partial(_evaluate_senses, problem), dynamics)
    ):
        present = step.sensed.zero_absent_readings()
        here = np.isfinite(step.sensed.off[0])
        xs[k] = step.x[0]
        cov[k] = np.linalg.inv(
            build_gauss_newton_hessian(present, dynamics.sigma_x, np.array([0]))[0]
        )
        # the prior is one more sense, which reads μ
        off = np.append(step.prior_off[0], step.sensed.off[0, here])
        sigma = np.append(problem.sigma_x, step.sensed.sigma[0, here])
        nats[k] = 0.5 * float((off * off / sigma + np.log(2 * np.pi * sigma)).sum())
    return xs, cov, nats


def _evaluate_senses(problem: GridProblem, k: int, x: Array) -> SensedErrors:
    """What the senses say at instant k about one belief (1,M)."""
    g, jac, own = problem.predict_senses(x)
    s, sigma = problem.stacked_readings
    off = s[k] - g
    variance = sigma[k] + own
    if problem.touch is not None:
        felt, slope = problem.touch.measure_touch_error(k, x[0])
        off = np.column_stack([off, [felt]])
        # σ_t is not printed: as σ_x and σ_p
        variance = np.column_stack([variance, [PAPER_VARIANCES[0]]])
        jac = np.concatenate([jac, slope[None, None]], axis=1)
    return SensedErrors(off, jac, variance)


def warn_of_unstable_step(problem: GridProblem) -> tuple[Finding, ...]:
    """A finding if Δt exceeds the stable step of Algorithm 1, with the slowest stable rate."""
    if problem.dt <= find_largest_stable_step(problem):
        return ()
    # a learned σ_x is smaller on a finer grid
    if problem.encoders is not None and not problem.encoders.printed:
        least = problem.encoders.sigma.min(axis=0) * TRIED_GAINS[0] / (1.0 - TRIED_GAINS[0])
        problem = replace(problem, sigma_x=np.minimum(problem.sigma_x, least))
    rate = 1.0 / find_largest_stable_step(problem)
    unit = 10.0 ** (np.floor(np.log10(rate)) - 1.0)
    rate = float(np.ceil(rate / unit) * unit)  # rounded up to two digits
    stable = f"the largest stable Δt is {1.0 / rate:.2g} s"
    text = f"explicit with Δt {problem.dt:g} s is unstable, {stable}"
    return (Finding("warning", f"step: {text}; type --rate {rate:g} or --step implicit"),)


def _warn_of_unread_joints(problem: GridProblem, evidence: Evidence) -> tuple[Finding, ...]:
    """A finding for joints without encoder readings, because σ_x is learned from encoders."""
    still = ", ".join(list_unread_joints(evidence))
    if not still or all(sense.printed for sense in problem.senses):
        return ()
    text = (
        f"knows no motion of {still} without encoders: errors are far beyond its error bars; "
        "type --method filter"
    )
    return (Finding("warning", f"predictive-coding: {text}"),)


def find_largest_stable_step(problem: GridProblem) -> float:
    """Largest stable Δt (s) at every posture of the log."""
    _, jac, own = problem.predict_senses(problem.postures)
    return measure_stable_step(
        jac, problem.stacked_readings[1].min(axis=0) + own, problem.sigma_x, problem.learning
    )


METHODS = {
    "predictive-coding": Method(
        estimate_by_predictive_coding,
        Capabilities(moves=False, density=False, repairs=False, from_paper=True),
        heeds=frozenset({"precision", "lambda", "sigma_encoders", "sigma_vision", "sigma_touch"}),
        literal_touch=True,
        encoder_model=True,
    )
}

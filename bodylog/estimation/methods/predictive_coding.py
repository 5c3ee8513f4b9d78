"""The paper's Algorithm 1 with its errata (docs/paper.md) corrected: free-energy descent, one Euler step per instant.

The explicit step integrates belief, errors and prior as printed; the linearly implicit one sets the errors to their
equilibrium and divides by I + Δt·H, H the Gauss–Newton Hessian, which is stable at any Δt.
"""

from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...errors import UsageError
from ...settings import Estimation
from ...types import Array, Estimate, Features, Finding
from ..measurements.gather import silent
from ..measurements.records import Evidence
from . import results
from .grid import GAINS, Plan, at_instants, plan_for

FAR = 100.0
"""rad: a belief beyond this has diverged."""


def estimate(features: Features, body: BodyModel, settings: Estimation) -> Estimate:
    """The belief on a grid of 20 Hz or `rate`; UsageError when an explicit step diverges."""
    plan, evidence, line = plan_for(features, body, settings)
    explicit = settings.step == "explicit" or settings.preset == "paper"
    x, cov, nats = (explicitly if explicit else implicitly)(plan)
    findings = step_warning(plan) if explicit else ()
    if not np.isfinite(x).all():
        why = findings[0].text if findings else "step: explicit; type --step implicit"
        raise UsageError(f"{why} (the belief left {FAR:g} rad)")
    findings = (*findings, *_without_encoders(plan, evidence, body.joints))
    steps = {"step": "explicit" if explicit else "implicit", "dt": plan.dt, "sigma_x": plan.sigma_x.tolist()}
    used = steps | {f"sigma_{s.name}": np.median(s.sigma, axis=0).tolist() for s in plan.senses}
    moved = np.maximum(np.einsum("nii->ni", cov), plan.moved)[:, :, None] * np.eye(x.shape[1])
    beliefs = at_instants(line, evidence, plan.encoders, x, cov, moved, nats, used, findings)
    return results.estimate("predictive-coding", body, evidence, line, beliefs)


def implicitly(plan: Plan) -> tuple[Array, Array, Array]:
    """x (N,M), covariance (N,M,M) as inverse Hessian, free energy (N,) nats; errors at their equilibrium."""
    m, n = len(plan.start), len(plan.t)
    x, mu, eye = plan.start.copy(), plan.start.copy(), np.eye(len(plan.start))
    xs, cov, nats = np.empty((n, m)), np.empty((n, m, m)), np.empty(n)
    follow = plan.dt * plan.learning / (plan.sigma_x + plan.dt * plan.learning)
    for k in range(n):
        force, hessian, nats[k] = descent(plan, k, x, mu, plan.predict(x))
        x = x + np.linalg.solve(eye + plan.dt * hessian, plan.dt * force)
        mu = mu + follow * (x - mu)
        xs[k], cov[k] = x, np.linalg.inv(hessian)
    return xs, cov, nats


def descent(
    plan: Plan, k: int, x: Array, mu: Array, predicted: tuple[Array, Array, Array]
) -> tuple[Array, Array, float]:
    """Force ∂F/∂x (M,), its Gauss–Newton Hessian (M,M) and the free energy at step k, errors at equilibrium.

    predicted: what the plan predicts at x.
    """
    (g, jac, own), (s, sigma) = predicted, (part[k] for part in plan.rows)
    here = np.isfinite(s)
    # the prior is one more sense, which reads μ
    e, var = np.append(mu - x, (s - g)[here]), np.append(plan.sigma_x, (sigma + own)[here])
    slope = np.vstack([np.eye(len(x)), jac[here]])
    force, hessian = slope.T @ (e / var), slope.T @ (slope / var[:, None])
    if plan.touch is not None and plan.touch.active[k]:
        pull, lean = plan.touch.pull(k, x)
        force, hessian = force + lean * pull, hessian + np.outer(lean, lean)
    return force, hessian, 0.5 * float((e * e / var + np.log(2 * np.pi * var)).sum())


def explicitly(plan: Plan) -> tuple[Array, Array, Array]:
    """As `implicitly`, by Algorithm 1: belief, errors and prior integrated together, one Euler step per instant."""
    m, n, (s, sigma) = len(plan.start), len(plan.t), plan.rows
    x, mu, ex, errors = plan.start.copy(), plan.start.copy(), np.zeros(len(plan.start)), np.zeros(s.shape[1])
    xs, cov, nats = np.full((n, m), np.nan), np.empty((n, m, m)), np.empty(n)
    for k in range(n):
        g, jac, own = plan.predict(x)
        _, hessian, nats[k] = descent(plan, k, x, mu, (g, jac, own))
        here = np.isfinite(s[k])
        errors = np.where(here, errors, 0.0)  # absent senses contribute nothing
        dx, de = jac.T @ errors - ex, np.where(here, s[k] - g - (sigma[k] + own) * errors, 0.0)
        if plan.touch is not None and plan.touch.active[k]:
            pull, lean = plan.touch.pull(k, x)
            dx = dx + lean * pull
        # corrected (docs/paper.md, Errata): ė_x = x̂ − μ − σ_x e_x, and μ̇ = λ e_x
        dex, dmu = x - mu - plan.sigma_x * ex, plan.learning * ex
        x, ex, mu, errors = (old + plan.dt * rate for old, rate in ((x, dx), (ex, dex), (mu, dmu), (errors, de)))
        if not np.abs(x).max() < FAR:
            break
        xs[k], cov[k] = x, np.linalg.inv(hessian)
    return xs, cov, nats


def step_warning(plan: Plan) -> tuple[Finding, ...]:
    """A finding if Δt exceeds the stable step of Algorithm 1, with the slowest stable rate."""
    if plan.dt <= stable_step(plan):
        return ()
    # a learned σ_x is smaller on a finer grid
    if plan.encoders is not None and not plan.encoders.printed:
        least = plan.encoders.sigma.min(axis=0) * GAINS[0] / (1.0 - GAINS[0])
        plan = replace(plan, sigma_x=np.minimum(plan.sigma_x, least))
    rate = 1.0 / stable_step(plan)
    unit = 10.0 ** (np.floor(np.log10(rate)) - 1.0)
    rate = float(np.ceil(rate / unit) * unit)  # rounded up to two digits
    text = f"explicit with Δt {plan.dt:g} s is unstable, the largest stable Δt is {1.0 / rate:.2g} s"
    return (Finding("warning", f"step: {text}; type --rate {rate:g} or --step implicit"),)


def _without_encoders(plan: Plan, evidence: Evidence, names: tuple[str, ...]) -> tuple[Finding, ...]:
    """A finding for joints without encoder readings, because σ_x is learned from encoders."""
    still = ", ".join(silent(names, evidence.encoders))
    if not still or all(sense.printed for sense in plan.senses):
        return ()
    text = f"knows no motion of {still} without encoders: errors are far beyond its error bars; type --method laplace"
    return (Finding("warning", f"predictive-coding: {text}"),)


def stable_step(plan: Plan) -> float:
    """Largest Δt (s) for which one explicit step shrinks every mode, linearised at every posture of the log."""
    predicted = [sense.predict(plan.postures) for sense in plan.senses]
    n, m = plan.postures.shape
    jac = np.concatenate([np.empty((n, 0, m)), *(jac for _, jac, _ in predicted)], axis=1)
    own = np.concatenate([np.empty((n, 0)), *(var for *_, var in predicted)], axis=1)
    sigma, i, o = plan.rows[1].min(axis=0) + own, np.eye(m) + np.zeros((n, 1, 1)), np.zeros((n, m, m))
    none = np.zeros_like(jac)
    a = np.block([  # rows and columns: x, e_x, μ, the senses' errors
        [o, -i, o, jac.swapaxes(1, 2)],
        [i, -plan.sigma_x * i, -i, none.swapaxes(1, 2)],
        [o, plan.learning * i, o, none.swapaxes(1, 2)],
        [-jac, none, none, -sigma[:, None] * np.eye(sigma.shape[1])],
    ])  # fmt: skip
    modes = np.linalg.eigvals(a)
    modes = modes[modes.real < -1e-9]
    return float((-2.0 * modes.real / np.abs(modes) ** 2).min()) if len(modes) else np.inf

"""The paper's Algorithm 1 with its errata (docs/paper.md) corrected: free-energy descent, one Euler step per instant.

The explicit step integrates belief, errors and prior as printed; the linearly implicit one sets the errors to their
equilibrium and divides by I + Δt·H, H the Gauss–Newton Hessian, which is stable at any Δt.
"""

from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...errors import UsageError
from ...settings import Estimation
from ...types import Array, Capabilities, Estimate, Features, Finding
from ..measurements.records import Evidence
from ..measurements.timeline import Timeline
from . import results
from .contract import VARIANCES, Method
from .grid import Plan, Sense, calmest, plan_for
from .results import Beliefs

__all__ = ["Plan", "Sense", "descent", "estimate", "explicitly", "implicitly", "plan_for", "stable_step"]

POSTURES, MARGIN = 16, 0.8
"""Postures of the log at which stability is checked, and the share of the largest stable Δt that is recommended."""
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
    beliefs = _beliefs(plan, evidence, line, x, cov, nats, findings, explicit)
    return results.estimate("predictive-coding", body, evidence, line, beliefs)


METHOD = Method(
    estimate, Capabilities(moves=False, density=False, repairs=False, from_paper=True),
    heeds=frozenset({"precision", "lambda", *VARIANCES} - {"process"}), literal_touch=True, encoder_model=True,
)  # fmt: skip


def implicitly(plan: Plan) -> tuple[Array, Array, Array]:
    """x (N,M), covariance (N,M,M) as inverse Hessian, free energy (N,) nats; errors at their equilibrium."""
    m, n = len(plan.start), len(plan.t)
    x, mu, eye = plan.start.copy(), plan.start.copy(), np.eye(len(plan.start))
    xs, cov, nats = np.empty((n, m)), np.empty((n, m, m)), np.empty(n)
    follow = plan.dt * plan.learning / (plan.sigma_x + plan.dt * plan.learning)
    for k in range(n):
        force, hessian, nats[k] = descent(plan, k, x, mu)
        x = x + np.linalg.solve(eye + plan.dt * hessian, plan.dt * force)
        mu = mu + follow * (x - mu)
        xs[k], cov[k] = x, np.linalg.inv(hessian)
    return xs, cov, nats


def descent(plan: Plan, k: int, x: Array, mu: Array) -> tuple[Array, Array, float]:
    """Force ∂F/∂x (M,), its Gauss–Newton Hessian (M,M) and the free energy at step k, errors at equilibrium."""
    e = x - mu
    force, hessian = -e / plan.sigma_x, np.diag(1.0 / plan.sigma_x)
    nats = 0.5 * float((e * e / plan.sigma_x + np.log(2 * np.pi * plan.sigma_x)).sum())
    for sense in plan.senses:
        here = np.isfinite(sense.s[k])
        if here.any():
            g, jac, own = sense.predict(x)
            e, jac, sigma = (sense.s[k] - g)[here], jac[here], (sense.sigma[k] + own)[here]
            force = force + jac.T @ (e / sigma)
            hessian = hessian + jac.T @ (jac / sigma[:, None])
            nats += 0.5 * float((e * e / sigma + np.log(2 * np.pi * sigma)).sum())
    if plan.touch is not None and plan.touch.active[k]:
        pull, slope = plan.touch.pull(k, x)
        force, hessian = force + slope * pull, hessian + np.outer(slope, slope)
    return force, hessian, nats


def explicitly(plan: Plan) -> tuple[Array, Array, Array]:
    """As `implicitly`, by Algorithm 1: belief, errors and prior integrated together, one Euler step per instant."""
    m, n = len(plan.start), len(plan.t)
    x, mu, ex = plan.start.copy(), plan.start.copy(), np.zeros(len(plan.start))
    errors = [np.zeros(sense.s.shape[1]) for sense in plan.senses]
    xs, cov, nats = np.full((n, m), np.nan), np.empty((n, m, m)), np.empty(n)
    for k in range(n):
        _, hessian, nats[k] = descent(plan, k, x, mu)
        dx = -ex
        for i, sense in enumerate(plan.senses):
            here = np.isfinite(sense.s[k])
            g, jac, own = sense.predict(x)
            sigma = sense.sigma[k] + own
            errors[i] = np.where(here, errors[i], 0.0)  # absent senses contribute nothing
            dx = dx + jac.T @ errors[i]
            errors[i] = errors[i] + plan.dt * np.where(here, sense.s[k] - g - sigma * errors[i], 0.0)
        if plan.touch is not None and plan.touch.active[k]:
            pull, slope = plan.touch.pull(k, x)
            dx = dx + slope * pull
        # corrected (docs/paper.md, Errata): ė_x = x̂ − μ − σ_x e_x, and μ̇ = λ e_x
        dex, dmu = x - mu - plan.sigma_x * ex, plan.learning * ex
        x, ex, mu = x + plan.dt * dx, ex + plan.dt * dex, mu + plan.dt * dmu
        if not np.abs(x).max() < FAR:
            break
        xs[k], cov[k] = x, np.linalg.inv(hessian)
    return xs, cov, nats


def step_warning(plan: Plan) -> tuple[Finding, ...]:
    """A finding if Δt exceeds the stable step of Algorithm 1, with the slowest stable rate."""
    if plan.dt <= _stable_everywhere(plan):
        return ()
    # σ_x is smaller on a finer grid, and the arm passes between the postures looked at
    rate = _rounded_up(1.0 / (MARGIN * _stable_everywhere(replace(plan, sigma_x=calmest(plan)))))
    text = f"explicit with Δt {plan.dt:g} s is unstable, the largest stable Δt is {1.0 / rate:.2g} s"
    return (Finding("warning", f"step: {text}; type --rate {rate:g} or --step implicit"),)


def _rounded_up(rate: float) -> float:
    """Rounded up to two digits."""
    unit = 10.0 ** (np.floor(np.log10(rate)) - 1.0)
    return float(np.ceil(rate / unit) * unit)


def _without_encoders(plan: Plan, evidence: Evidence, names: tuple[str, ...]) -> tuple[Finding, ...]:
    """A finding for joints without encoder readings, because σ_x is learned from encoders."""
    readings = np.empty((0, len(names))) if evidence.encoders is None else evidence.encoders.values
    still = ", ".join(name for name, column in zip(names, readings.T, strict=True) if not np.isfinite(column).any())
    if not still or all(sense.printed for sense in plan.senses):
        return ()
    text = f"knows no motion of {still} without encoders: errors are far beyond its error bars; type --method laplace"
    return (Finding("warning", f"predictive-coding: {text}"),)


def _stable_everywhere(plan: Plan) -> float:
    """The least stable step (s) over postures of the log's encoders."""
    postures = [plan.start]
    if plan.senses and plan.senses[0].name == "encoders" and plan.senses[0].model is None:
        readings = plan.senses[0].s[np.isfinite(plan.senses[0].s).all(axis=1)]
        postures += list(readings[np.linspace(0, len(readings) - 1, min(POSTURES, len(readings))).astype(int)])
    return min(stable_step(replace(plan, start=x)) for x in postures)


def stable_step(plan: Plan) -> float:
    """Largest Δt (s) for which one explicit step shrinks every mode of the linearised dynamics at the start."""
    x, m = plan.start, len(plan.start)
    blocks = [(jac, sense.sigma.min(axis=0) + own) for sense in plan.senses for _, jac, own in [sense.predict(x)]]
    size = 3 * m + sum(len(sigma) for _, sigma in blocks)
    a = np.zeros((size, size))  # rows: x, e_x, μ, then the senses' errors
    own, ex, mu = slice(0, m), slice(m, 2 * m), slice(2 * m, 3 * m)
    a[own, ex], a[ex, own], a[ex, mu] = -np.eye(m), np.eye(m), -np.eye(m)
    a[ex, ex], a[mu, ex] = -np.diag(plan.sigma_x), plan.learning * np.eye(m)
    at = 3 * m
    for jac, sigma in blocks:
        rows = slice(at, at + len(sigma))
        a[own, rows], a[rows, own], a[rows, rows] = jac.T, -jac, -np.diag(sigma)
        at += len(sigma)
    modes = np.linalg.eigvals(a)
    modes = modes[modes.real < -1e-9]
    return float((-2.0 * modes.real / np.abs(modes) ** 2).min()) if len(modes) else np.inf


def _beliefs(
    plan: Plan, evidence: Evidence, line: Timeline, x: Array, cov: Array, nats: Array,
    findings: tuple[Finding, ...], explicit: bool,
) -> Beliefs:  # fmt: skip
    """Beliefs on the grid, held until the next, at every instant of the timeline."""
    rate = np.diff(x, axis=0, prepend=x[:1]) / plan.dt
    held = np.maximum(np.searchsorted(plan.t, line.t, "right") - 1, 0)
    before = np.maximum(np.searchsorted(plan.t, line.t, "left") - 1, 0)
    every = np.zeros(len(line.t))
    every[line.outputs] = nats
    errors, moved = np.full((len(line.t), x.shape[1]), np.nan), _moved(plan, x, cov)
    if evidence.encoders is not None:
        then, sense = before[line.encoders], plan.senses[0]
        read, slope = x[then], np.ones_like(x[then])
        if sense.model is not None:
            read, jac, _ = sense.model.predict(read)
            slope = np.einsum("nmm->nm", jac)
        std = np.sqrt(sense.sigma[then] + slope**2 * np.einsum("nii->ni", moved[then]))
        errors[line.encoders] = (evidence.encoders.values - read) / std
    settings = {"step": "explicit" if explicit else "implicit", "dt": plan.dt, "sigma_x": plan.sigma_x.tolist()}
    settings |= {f"sigma_{s.name}": np.median(s.sigma, axis=0).tolist() for s in plan.senses}
    z = np.concatenate([x, rate], axis=1)[held]
    return Beliefs(z, cov[held], every, x[before], moved[before], errors, {}, settings, (), findings)


def _moved(plan: Plan, x: Array, cov: Array) -> Array:
    """Covariance (N,M,M) of beliefs x (N,M) by the next reading, in which the arm has moved.

    It grows by the encoders' mean squared deviation from the static belief, beyond their noise.
    """
    var, sense = np.einsum("nii->ni", cov), plan.senses[0] if plan.senses else None
    if sense is not None and sense.name == "encoders" and sense.model is None:
        present, held, square = np.isfinite(sense.s), plan.start, np.zeros(x.shape[1])
        for readings, noise, here in zip(sense.s, sense.sigma, present, strict=True):
            off = np.where(here, readings - held, 0.0)
            square += off * off - here * noise
            held = held + plan.sigma_x / (plan.sigma_x + noise) * off
        var = np.maximum(var, square / np.maximum(present.sum(axis=0), 1))
    return np.asarray(var[:, :, None] * np.eye(x.shape[1]))

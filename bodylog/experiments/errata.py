"""Errata: the printed equations run as they stand, beside the form that can be run."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..settings import Estimation
from ..types import BodyModel
from .beliefs import ours, printed
from .lab import ELSEWHERE, JOINTS, Heard, Lab
from .records import Bound, Claim, Experiment, Trial, both, judge

if TYPE_CHECKING:
    from ..body.gp import GP

LASTING = 60.0
"""s for which the belief is integrated."""
DT = 0.05
"""s: the printed step."""


def _run(lab: Lab, seed: int) -> Trial:
    heard = lab.heard("horizontal", seed + ELSEWHERE, duration=12.0, noise=0.02)
    own, paper = (lab.body(preset, seed, "horizontal") for preset in ("default", "paper"))
    stable = _stable_steps(heard, own)
    jacobian, least = _jacobian_errors(_effector(own)), _least_eigenvalues(_effector(own))
    raw = _raw(heard)
    figures = {
        "printed prior": grown(heard, True), "ours prior": grown(heard, False),
        "printed step": stable["pixels"], "ours step": stable["widths"],
        "printed model": off(heard, paper), "ours model": off(heard, own),
        "printed lag": printed(heard, paper, ("encoders", "vision")).rmse(2.0) / raw,
        "ours lag": ours(heard, own).rmse(2.0) / raw,
        "printed jacobian": jacobian[0], "ours jacobian": jacobian[1],
        "printed least eigenvalue": least[0], "ours least eigenvalue": least[1],
    }  # fmt: skip
    return {"figures": figures, "panels": []}


def grown(heard: Heard, as_printed: bool) -> float:
    """log₁₀ of the largest belief (rad) in 60 s of Algorithm 1 on encoders, with μ̇ = μ + λe_x or μ̇ = λe_x."""
    x = mu = s = heard.true(JOINTS, heard.truth.t[:1])[0]
    ex, ep, most = np.zeros(3), np.zeros(3), 0.0
    for _ in range(int(LASTING / DT)):
        dmu = ex + mu if as_printed else ex
        dx, dex, dep = ep - ex, x - mu - ex, s - x - ep
        x, mu, ex, ep = x + DT * dx, mu + DT * dmu, ex + DT * dex, ep + DT * dep
        most = max(most, float(np.abs(x).max()))
    return float(np.log10(most))


def _stable_steps(heard: Heard, body: BodyModel) -> dict[str, float]:
    """Largest stable Euler step (s) with the printed variances, tracks in pixels or in image widths."""
    from ..estimation.methods import predictive_coding as algorithm
    from ..estimation.methods.grid import plan_for

    settings = Estimation(method="predictive-coding", preset="paper", senses=("encoders", "vision"))
    plan, _, _ = plan_for(heard.features, body, settings)
    pixels = tuple(replace(s, s=s.s * s.unit, unit=1.0) for s in plan.senses)
    return {"widths": algorithm.stable_step(plan), "pixels": algorithm.stable_step(replace(plan, senses=pixels))}


def off(heard: Heard, body: BodyModel) -> float:
    """Root mean square distance (px, per coordinate) of where the model puts the effector from where it is seen."""
    track = heard.features.tracks["effector"]
    seen = np.isfinite(track.values).all(axis=1)
    mean, _, _ = body.senses["effector"].predict(heard.true(body.joints, track.t[seen]))
    return float(np.sqrt(np.mean((mean - track.values[seen]) ** 2)))


def _raw(heard: Heard) -> float:
    """Error (rad) of the encoders themselves."""
    joints = heard.features.joints
    assert joints is not None
    columns = [joints.names.index(name) for name in JOINTS]
    return float(np.sqrt(np.mean((joints.values[:, columns] - heard.true(JOINTS, joints.t)) ** 2)))


def _effector(body: BodyModel) -> "GP":
    from ..body.gp import GP

    model = body.senses["effector"]
    assert isinstance(model, GP)
    return model


def _jacobian_errors(model: "GP") -> tuple[float, float]:
    """Relative error of the Jacobian against central differences: with the length scales as printed, and ours."""
    x = np.median(model.samples, axis=0) + 0.05
    steps = 1e-5 * np.eye(len(x))
    slopes = (model.predict(x + steps)[0] - model.predict(x - steps)[0]).T / 2e-5
    own = model.predict(x[None])[1][0]
    as_printed = own * model.scales[0] ** 4
    size = np.abs(slopes).max()
    return float(np.abs(as_printed - slopes).max() / size), float(np.abs(own - slopes).max() / size)


def _least_eigenvalues(model: "GP") -> tuple[float, float]:
    """The least eigenvalue of K over σ_n², with the learned kernel: σ_n² on every entry of K, and on its diagonal."""
    x, noise = model.samples[::8], float(model.noise[0] / model.amplitude[0])
    k = np.exp(-0.5 * np.square((x[:, None] - x[None]) / model.scales[0]).sum(axis=2))
    everywhere, diagonal = np.linalg.eigvalsh(k + noise)[0], np.linalg.eigvalsh(k + noise * np.eye(len(k)))[0]
    return float(everywhere / noise), float(diagonal / noise)


def _claims(trials: Sequence[Trial]) -> tuple[Claim, ...]:
    def claim(text: str, name: str, measured: str, unit: str, bound: Bound, said: str) -> Claim:
        return judge("Errata", text, measured, unit, bound, both(trials, name), said)

    return (
        claim("μ̇ = μ + λe_x keeps the belief within 10 rad for 60 s", "prior", "log₁₀ of the largest belief",
              "log₁₀ rad", Bound("≤", 1.0), "the prior feeds on itself; run as μ̇ = λe_x"),
        claim("explicit Euler is stable at Δt = 0.05 s, σ_v = 5 px²", "step", "largest stable step", "s",
              Bound("≥", DT), "stable when σ_v is in squared image widths, or with the linearly implicit step"),
        claim("l = exp(0.1), σ_n = exp(0.02) model the effector to 2 px", "model", "error of the model", "px",
              Bound("≤", 2.0), "the evidence chooses l, amplitude and noise in ours"),
        claim("with σ_x = σ_p = 1, λ = 1 the belief is at least as good as the raw encoders", "lag",
              "belief's error over the encoders'", "1", Bound("≤", 1.0),
              "these constants make it lag; ours learns them"),
        claim("−Λ⁻¹(x̂ − X) with Λ = diag(1/l²) is the derivative", "jacobian", "relative error against differences",
              "1", Bound("≤", 1e-3), "the inverse is taken twice: off by l⁴; run as (x̂ − X)/l²"),
        claim("k_ij = σ_n² + k regularises K", "least eigenvalue", "least eigenvalue of K over σ_n²", "1",
              Bound("≥", 0.5), "on every entry it lifts one direction only; run with σ_n² on the diagonal"),
    )  # fmt: skip


EXPERIMENT = Experiment("Errata", "The equations as printed", _run, _claims)

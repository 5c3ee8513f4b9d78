"""Errata whose effect is a figure: the equations as printed and in the form that works.

The others are derivations (docs/paper.md); tests derive each again by numbers.
"""

from collections.abc import Sequence

import numpy as np

from ..estimation.methods.algorithm1 import measure_stable_step
from ..types import Array
from . import drawn
from .cases import explore_by_preset, sample_signals
from .claims import Bound, Claim
from .judging import judge_erratum
from .lab import Lab
from .printed import DT, Map
from .records import Experiment, ExperimentReadings, Trial, figure_column

LASTING_S = 60.0
"""For how long the belief is integrated."""


def _run_errata(lab: Lab, seed: int, tried: ExperimentReadings) -> Trial:
    log = sample_signals(drawn.draw_log(15.0, 0.02, seed, (True, True, False)))
    known = explore_by_preset(lab.body("paper", seed, "horizontal"))
    figures = {
        "printed prior": grow_belief(log.encoders, True),
        "ours prior": grow_belief(log.encoders, False),
        "printed step": find_stable_step(known.map({}), log.true[0], 1.0),
        "ours step": find_stable_step(known.map({}), log.true[0], known.scatter),
    }
    return {"figures": figures, "panels": []}


def grow_belief(encoders: Array, as_printed: bool) -> float:
    """log₁₀ of the largest belief (rad) in 60 s of Algorithm
    1 on encoders, with μ̇ = μ + λe_x or μ̇ = λe_x.
    """
    x = encoders[0]
    mu = x
    s = x
    ex = np.zeros(3)
    ep = np.zeros(3)
    most = 0.0
    for _ in range(int(LASTING_S / DT)):
        dmu = ex + mu if as_printed else ex
        dx = ep - ex
        dex = x - mu - ex
        dep = s - x - ep
        x = x + DT * dx
        mu = mu + DT * dmu
        ex = ex + DT * dex
        ep = ep + DT * dep
        most = max(most, float(np.abs(x).max()))
    return float(np.log10(most))


def find_stable_step(model: Map, x: Array, unit_px: float) -> float:
    """Largest Δt (s) at which one Euler step of Algorithm 1
    with σ_v = 5 of this unit² shrinks every mode at x (M,).
    """
    m = len(x)
    slope = np.concatenate([np.eye(m), slope_by_differences(model, x) / unit_px])
    return measure_stable_step(
        slope[None], np.append(np.ones((1, m)), [[5.0, 5.0]], 1), np.ones(m), 1.0
    )


def slope_by_differences(model: Map, x: Array) -> Array:
    """∂g/∂x (2,M) px/rad by central differences."""
    steps = 1e-5 * np.eye(len(x))
    return np.asarray((model.at(x + steps) - model.at(x - steps)).T / 2e-5)


EQUATIONS: tuple[tuple[str, str, str, str, Bound, str], ...] = (
    (
        "prior",
        "μ̇ = μ + λe_x keeps the belief within 10 rad for 60 s",
        "log₁₀ of the largest belief",
        "log₁₀ rad",
        Bound("≤", 1.0),
        "μ̇ = μ + λe_x has the solution e^t where e_x = 0; the algorithm's step μ ← μ + λe_x "
        "is meant; "
        "as a rate that is μ̇ = λe_x",
    ),
    (
        "step",
        "explicit Euler is stable at Δt = 0.05 s with σ_v = [5, 5], which has no unit: read "
        "in px², "
        "and run in squared scatters of the outputs",
        "largest stable step",
        "s",
        Bound("≥", DT),
        "Ẋ = AX with A from J, σ: an Euler step shrinks a mode a when Δt < −2 Re a/|a|²; for "
        "vision |a|² ≈ |J|², "
        "Re a = −σ_v/2, so Δt < σ_v/|J|²; |J| is some 300 px/rad and 7 per scatter",
    ),
)
"""Figure's name · the printed claim · what is measured,
its unit and bound · derivation; numbered from 1.
"""


def _claim_errata(trials: Sequence[Trial], tried: ExperimentReadings) -> tuple[Claim, ...]:
    def compared(name: str) -> dict[str, Sequence[float]]:
        return {
            "as printed": figure_column(trials, f"printed {name}"),
            "as run": figure_column(trials, f"ours {name}"),
        }

    return tuple(
        judge_erratum(f"Errata.{k}", text, measured, unit, bound, compared(name), derivation)
        for k, (name, text, measured, unit, bound, derivation) in enumerate(EQUATIONS, 1)
    )


EXPERIMENT = Experiment("Errata", "The equations as printed", _run_errata, _claim_errata)

"""What the printed model and ours believe of a log, and the panels that show it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .. import pipeline
from ..settings import Estimation, Settings
from ..types import Array, BodyModel, Estimate
from .lab import NAMES, Heard
from .records import SIDES, panel


@dataclass(frozen=True, eq=False)
class Belief:
    """A belief over time: t (N,) s · x (N,M) rad, NaN after it diverged · true (N,M) rad."""

    t: Array
    x: Array
    true: Array

    def error(self, since: float) -> Array:
        """Belief minus truth (K,M) rad from `since` s on."""
        return np.asarray((self.x - self.true)[self.t >= since])

    def rmse(self, since: float) -> float:
        """Root mean square error over all joints (rad) from `since` s on; NaN when the belief diverged."""
        return float(np.sqrt(np.mean(self.error(since) ** 2)))


def ours(heard: Heard, body: BodyModel, senses: tuple[str, ...] | None = None, **settings: Any) -> Belief:
    """What our default believes."""
    return believed(estimated(heard, body, Estimation(senses=senses, **settings)), heard)


def estimated(heard: Heard, body: BodyModel, settings: Estimation) -> Estimate:
    """The estimate by these settings."""
    return pipeline.infer(heard.features, body, replace(Settings(), estimate=settings))


def believed(found: Estimate, heard: Heard) -> Belief:
    """An estimate beside the truth."""
    return Belief(found.joints.t, found.joints.values, heard.true(found.joints.names, found.joints.t))


def kalman(heard: Heard, body: BodyModel, start: tuple[float, ...] | None = None) -> Belief:
    """What the paper's Kalman filter believes."""
    return ours(heard, body, ("encoders",), method="kalman", start=start)


def printed(
    heard: Heard, body: BodyModel, senses: tuple[str, ...], start: tuple[float, ...] | None = None,
    sigma_v: float | None = None, implicit: bool = False,
) -> Belief:  # fmt: skip
    """What Algorithm 1 believes with the printed constants, errata applied; `sigma_v` in place of the printed 5.

    `implicit` puts the prediction errors at their equilibrium instead of integrating them.
    """
    from ..estimation.methods import predictive_coding as algorithm
    from ..estimation.methods.grid import plan_for

    settings = Estimation(method="predictive-coding", preset="paper", touch="literal", senses=senses, start=start)
    plan, _, _ = plan_for(heard.features, body, settings)
    if sigma_v is not None:
        changed = [s if s.name == "encoders" else replace(s, sigma=np.full_like(s.sigma, sigma_v)) for s in plan.senses]
        plan = replace(plan, senses=tuple(changed))
    x, _, _ = (algorithm.implicitly if implicit else algorithm.explicitly)(plan)
    return Belief(plan.t, x, heard.true(body.joints, plan.t))


def noisier(heard: Heard, std: float, seed: int) -> Heard:
    """The same log with more noise (rad) on its encoders."""
    joints = heard.features.joints
    assert joints is not None
    noise = std * np.random.default_rng([seed, 11]).standard_normal(joints.values.shape)
    return replace(heard, features=replace(heard.features, joints=replace(joints, values=joints.values + noise)))


def typed(body: BodyModel) -> BodyModel:
    """The body with the printed touch constants, a_1 = 0.001 and b_1 = 1 (1/px²)."""
    return replace(body, touch=replace(body.touch, a1=0.001, b1=1.0))


def shaped(body: BodyModel, width: float) -> BodyModel:
    """The body with a_1 = 1 and f_s of another width 1/√(2 b_1) (px)."""
    return replace(body, touch=replace(body.touch, a1=1.0, b1=1.0 / (2.0 * width**2)))


def mean_errors(beliefs: Mapping[tuple[str, str], Belief], side: str) -> dict[str, Any]:
    """The panel of one side's mean absolute errors (rad), a line for each of its beliefs (side, senses)."""
    own = {name: belief for (of, name), belief in beliefs.items() if of == side}
    t = beliefs[side, "p"].t
    lines = {name: np.interp(t, b.t, np.abs(b.x - b.true).mean(axis=1)) for name, b in own.items()}
    return panel(f"{side}: mean absolute error", "rad", t, lines)


def angles(beliefs: Mapping[tuple[str, str], Belief], senses: tuple[str, ...]) -> list[dict[str, Any]]:
    """A panel for each joint as in the paper: what both sides believe by some senses, and the truth."""
    shown = {f"{side} {name}": beliefs[side, name] for side in SIDES for name in senses}
    first = beliefs["printed", senses[0]]
    panels = []
    for i, joint in enumerate(NAMES):
        lines = {name: np.interp(first.t, b.t, b.x[:, i]) for name, b in shown.items()}
        panels.append(panel(joint, "rad", first.t, lines | {"truth": first.true[:, i]}))
    return panels

"""Inputs of predictive coding: each sense on one grid of times, with its variance."""

from dataclasses import dataclass

import numpy as np

from ...body_model import BodyModel, ForwardModel
from ...settings import Estimation
from ...types import Array, Features
from ..faults.screening import screened
from ..measurements.gather import start
from ..measurements.records import Evidence
from ..measurements.timeline import Timeline, timeline
from ..noise import typed
from ..noise.noise_model import resolve, warned
from .paper_touch import Literal, literal

RATE = 20.0
"""Hz: the paper's Δt of 0.05 s."""
PAPER = (1.0, 1.0, 5.0)
"""The paper's σ_x, σ_p (rad²) and σ_v (pixels divided by the image width, squared)."""
LEARNING = 1.0
"""The paper's λ, 1/s: rate at which the prior follows the belief."""
GAINS = np.linspace(0.05, 0.95, 19)
"""Gains tried for a static belief."""


@dataclass(frozen=True, eq=False)
class Sense:
    """One sense on the grid: s (N,D), NaN where absent · model (None: the angles themselves) · σ (N,D) · unit of s.

    `printed`: the model's own variance is dropped, as the paper drops it.
    """

    name: str
    s: Array
    model: ForwardModel | None
    sigma: Array
    unit: float = 1.0
    printed: bool = False

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """g (D,), J (D,M) and the model's own variance (D,) at x (M,), in the sense's unit."""
        if self.model is None:
            return x, np.eye(len(x)), np.zeros(len(x))
        mean, jac, var = self.model.predict(x[None])
        return mean[0] / self.unit, jac[0] / self.unit, var[0] * (not self.printed) / self.unit**2


@dataclass(frozen=True, eq=False)
class Plan:
    """What to integrate: senses, touch as printed, grid t (N,) s, Δt s, σ_x (M,), start (M,), λ 1/s of the prior."""

    senses: tuple[Sense, ...]
    touch: Literal | None
    t: Array
    dt: float
    sigma_x: Array
    start: Array
    learning: float = LEARNING


def plan_for(features: Features, body: BodyModel, settings: Estimation) -> tuple[Plan, Evidence, Timeline]:
    """Senses on the grid with their variances: the paper's by preset, else by `precision`."""
    printed = settings.preset == "paper" or settings.touch == "literal"
    # descent integrates over time, so frames of one touch may count separately;
    # faults are reported, but their readings are used as in the paper
    evidence = screened(features, body, settings, whole=False, repairs=False)
    rate = settings.rate or RATE
    line = timeline(evidence, rate)
    t, dt, m = line.t[line.outputs], 1.0 / rate, len(body.joints)
    paper = settings.preset == "paper" or settings.precision == "fixed"
    precision = None if paper else resolve(evidence, body, settings)
    evidence = evidence if paper else warned(evidence, body, settings)
    found = np.full(m, PAPER[1]) if precision is None else precision.encoder
    noise = typed.of_joints(settings.sigma_encoders, body.joints, found)
    senses = [] if evidence.encoders is None else [_encoders(evidence, body, t, noise, paper)]
    width = image_width(features, body)
    for sighting in evidence.sightings:
        if sighting.name == "touch" and printed:
            continue
        s, rows = on_grid(sighting.t, sighting.values, t)
        unit = width if paper else 1.0
        scale = 1.0 if precision is None else precision.scale.get(sighting.name, 1.0)
        own, variance = scale * sighting.var[rows] / unit**2, typed.of_track(settings, sighting.name)
        sigma = np.full(s.shape, PAPER[2]) if paper and sighting.name != "touch" else own
        sigma = sigma if variance is None else np.full(s.shape, variance / unit**2)
        senses.append(Sense(sighting.name, s / unit, sighting.model, sigma, unit, paper))
    touch = literal(features, body, t, dt) if printed and any(s.name == "touch" for s in evidence.sightings) else None
    sigma_x = np.full(m, PAPER[0]) if precision is None else _wander(senses[:1], noise)
    first, learning = start(evidence, settings, body.joints), LEARNING if settings.lambda_ is None else settings.lambda_
    return Plan(tuple(senses), touch, t, dt, sigma_x, first, learning), evidence, line


def calmest(plan: Plan) -> Array:
    """The least σ_x (M,) for any finer grid; the paper's is the same on all."""
    learned = plan.senses and plan.senses[0].name == "encoders" and (plan.sigma_x != PAPER[0]).any()
    least = plan.senses[0].sigma.min(axis=0) * GAINS[0] / (1.0 - GAINS[0]) if learned else plan.sigma_x
    return np.asarray(np.minimum(plan.sigma_x, least))


def _encoders(evidence: Evidence, body: BodyModel, t: Array, variance: Array, printed: bool) -> Sense:
    assert evidence.encoders is not None
    s, _ = on_grid(evidence.encoders.t, evidence.encoders.values, t)
    sigma = np.broadcast_to(variance, s.shape)
    return Sense("encoders", s, body.senses.get("encoders"), sigma, printed=printed)


def on_grid(t: Array, values: Array, grid: Array) -> tuple[Array, Array]:
    """Values (N,D) at the grid times, each row of (t, values) used once, at the nearest; the rows' indices (N,).

    A row is moved to its grid time along the line to its neighbour; NaN where no row is nearest.
    """
    rows = nearest(t, grid)
    mine = nearest(grid, t)[rows] == np.arange(len(grid))
    late = grid >= t[rows]
    other = np.clip(rows + np.where(late, 1, -1), 0, len(t) - 1)
    apart = np.where(other == rows, 1.0, t[other] - t[rows])
    moved = values[rows] + ((grid - t[rows]) / apart)[:, None] * (values[other] - values[rows])
    moved = np.where(np.isfinite(moved), moved, values[rows])
    return np.where(mine[:, None], moved, np.nan), rows


def nearest(t: Array, at: Array) -> Array:
    """Index (N,) of the time in ascending t nearest to each of `at`."""
    right = np.clip(np.searchsorted(t, at), 1, max(len(t) - 1, 1))
    left = right - 1
    closer = np.abs(at - t[left]) <= np.abs(t[np.minimum(right, len(t) - 1)] - at)
    return np.where(closer, left, np.minimum(right, len(t) - 1))


def image_width(features: Features, body: BodyModel) -> float:
    """Pixels that count as 1: the image's width if the body stores it, else the largest coordinate."""
    if "image_width" in body.provenance:
        return float(body.provenance["image_width"])
    seen = [np.nanmax(np.abs(s.values)) for s in features.tracks.values() if np.isfinite(s.values).any()]
    return float(max(seen, default=1.0))


def _wander(encoders: list[Sense], noise: Array) -> Array:
    """σ_x (M,): motion variance with which a static belief predicts the next encoder reading best."""
    if not encoders or encoders[0].name != "encoders":
        return noise
    gains, s = GAINS[:, None], encoders[0].s
    x, squares = np.where(np.isfinite(s[0]), s[0], 0.0) + 0.0 * gains, np.zeros((len(gains), s.shape[1]))
    for row in s[1:]:
        nu = np.where(np.isfinite(row), row - x, 0.0)
        squares += nu * nu
        x = x + gains * nu
    best = gains[squares.argmin(axis=0), 0]
    return np.asarray(noise * best / (1.0 - best))

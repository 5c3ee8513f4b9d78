"""Inputs of predictive coding: each sense on one grid of times, with its variance."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...body_model import BodyModel, ForwardModel
from ...settings import EstimationSettings
from ...types import Array, Features, Finding
from ..faults.screening import screen_measurements
from ..measurements.gather import choose_initial_angles
from ..measurements.long_arrays import find_finite_rows
from ..measurements.records import Evidence, Sighting, interpolate_values
from ..measurements.timeline import Timeline, build_timeline
from ..noise import noise_model
from ..noise.noise_model import PAPER_VARIANCES, resolve_noise_model, warn_of_few_readings
from .algorithm1 import PaperTouch, build_paper_touch
from .results import Beliefs

GRID_RATE_HZ = 20.0
"""Hz: the paper's Δt of 0.05 s."""
TRIED_GAINS = np.linspace(0.05, 0.95, 19)
"""Gains tried for a static belief."""


@dataclass(frozen=True, eq=False)
class GridSense:
    """One sense on the grid: s (N,D), NaN where absent ·
    model (None: the angles themselves) · σ (N,D) · unit of s.

    `printed`: the model's own variance is dropped, as the paper drops it.
    """

    name: str
    s: Array
    model: ForwardModel | None
    sigma: Array
    unit: float = 1.0
    printed: bool = False

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """g (N,D), J (N,D,M) and the model's own variance (N,D) at x (N,M), in the sense's unit."""
        if self.model is None:
            return x, np.tile(np.eye(x.shape[1]), (len(x), 1, 1)), np.zeros(x.shape)
        mean, jac, var = self.model.predict(x)
        return mean / self.unit, jac / self.unit, var * (not self.printed) / self.unit**2


@dataclass(frozen=True, eq=False)
class GridProblem:
    """What to integrate: senses, touch as printed, grid t (N,) s, Δt s, σ_x (M,), start (M,).

    moved (M,) rad²: variance of the motion until the next reading ·
    postures (P,M) rad: the start, and all readings · learning: λ, 1/s,
    the rate at which the prior follows the belief; 1 is the paper's.
    """

    senses: tuple[GridSense, ...]
    touch: PaperTouch | None
    t: Array
    dt: float
    sigma_x: Array
    start: Array
    moved: Array
    postures: Array
    learning: float = 1.0

    @property
    def encoders(self) -> GridSense | None:
        """The sense of encoders, if there is one."""
        return next((sense for sense in self.senses if sense.name == "encoders"), None)

    @cached_property
    def stacked_readings(self) -> tuple[Array, Array]:
        """Readings (N,R), NaN where absent, and variances (N,R) of all senses beside each other."""
        none = np.empty((len(self.t), 0))
        s = np.hstack([none, *(sense.s for sense in self.senses)])
        sigma = np.hstack([none, *(sense.sigma for sense in self.senses)])
        return s, sigma

    def predict_senses(self, x: Array) -> tuple[Array, Array, Array]:
        """g (N,R), J (N,R,M) and the models' own variances (N,R) of all senses at x (N,M)."""
        none = x[:, :0], np.empty((len(x), 0, x.shape[1])), x[:, :0]
        parts = zip(none, *(sense.predict(x) for sense in self.senses), strict=True)
        g, jac, own = (np.concatenate(part, axis=1) for part in parts)
        return g, jac, own


def build_grid_problem(
    features: Features, body: BodyModel, settings: EstimationSettings
) -> tuple[GridProblem, Evidence, Timeline]:
    """Senses on the grid with their variances: the paper's by preset, else by `precision`."""
    if settings.preset == "paper":
        settings = replace(settings, precision="fixed", touch="literal")
    # faults are reported, but their readings are used as in the paper
    evidence = warn_of_few_readings(
        screen_measurements(features, body, settings, repairs=False), body, settings
    )
    rate = settings.rate or GRID_RATE_HZ
    line = build_timeline(evidence, rate)
    t = line.t[line.outputs]
    paper = settings.precision == "fixed"
    noise = noise_model.with_typed_noise(
        resolve_noise_model(evidence, body, settings), settings, body.joints
    )
    encoders = None
    if evidence.encoders is not None:
        s, _ = place_on_grid(evidence.encoders.t, evidence.encoders.values, t)
        sigma = np.broadcast_to(noise.encoder, s.shape)
        encoders = GridSense("encoders", s, body.senses.get("encoders"), sigma, printed=paper)
    gains = (
        PAPER_VARIANCES[0] / (PAPER_VARIANCES[0] + noise.encoder[None])
        if paper
        else np.tile(TRIED_GAINS[:, None], len(noise.encoder))
    )
    sigma_x, moved = _learn_static_variances(encoders, noise.encoder, gains)
    felt = settings.touch == "literal" and any(s.name == "touch" for s in evidence.sightings)
    width = find_image_width(features, body) if paper else None
    seen = [
        s
        for s in noise_model.with_typed_variances(evidence.sightings, settings)
        if not (felt and s.name == "touch")
    ]
    senses = [] if encoders is None else [encoders]
    senses += [
        _build_visual_sense(
            s,
            t,
            noise.scale.get(s.name, 1.0),
            width,
            noise_model.find_typed_variance(settings, s.name),
        )
        for s in seen
    ]
    touch = build_paper_touch(features, body, t, 1.0 / rate) if felt else None
    learning = GridProblem.learning if settings.lambda_ is None else settings.lambda_
    first = choose_initial_angles(evidence, settings)
    angles = encoders is not None and encoders.model is None
    read = evidence.encoders.values if evidence.encoders is not None and angles else first[None]
    postures = np.concatenate([first[None], read[find_finite_rows(read)]])
    return (
        GridProblem(tuple(senses), touch, t, 1.0 / rate, sigma_x, first, moved, postures, learning),
        evidence,
        line,
    )


def _build_visual_sense(
    found: Sighting, t: Array, scale: float, width: float | None, given: float | None
) -> GridSense:
    """A track or touch; in image widths with the paper's
    variance if `width` (px), and no variance, is given.
    """
    s, rows = place_on_grid(found.t, found.values, t)
    if width is None:
        return GridSense(found.name, s, found.model, scale * found.var[rows])
    own = found.name == "touch" or given is not None
    sigma = found.var[rows] / width**2 if own else np.full(s.shape, PAPER_VARIANCES[2])
    return GridSense(found.name, s / width, found.model, sigma, width, printed=True)


def place_on_grid(t: Array, values: Array, grid: Array) -> tuple[Array, Array]:
    """Values (N,D) at the grid times, each row of (t, values)
    used once, at the nearest; the rows' indices (N,).

    A row is moved to its grid time along the line to its neighbour; NaN where no row is nearest.
    """
    rows = find_nearest_index(t, grid)
    mine = (find_nearest_index(grid, t)[rows] == np.arange(len(grid)))[:, None] & np.isfinite(
        values[rows]
    )
    return np.where(mine, interpolate_values(t, values, grid), np.nan), rows


def find_nearest_index(t: Array, at: Array) -> Array:
    """Index (N,) of the time in ascending t nearest to each of `at`."""
    return np.asarray(np.searchsorted(0.5 * (t[1:] + t[:-1]), at))


def hold_beliefs_at_instants(
    line: Timeline,
    evidence: Evidence,
    encoders: GridSense | None,
    x: Array,
    cov: Array,
    moved: Array,
    nats: Array,
    settings: Mapping[str, Any],
    findings: tuple[Finding, ...] = (),
) -> Beliefs:
    """Beliefs x (N,M) on the grid, held until the next, at
    every instant; `moved` (N,M,M): their covariance by then.
    """
    t = line.t[line.outputs]
    every = np.zeros(len(line.t))
    errors = np.full((len(line.t), x.shape[1]), np.nan)
    held = np.maximum(np.searchsorted(t, line.t, "right") - 1, 0)
    before = np.maximum(np.searchsorted(t, line.t, "left") - 1, 0)
    every[line.outputs] = nats
    rate = np.diff(x, axis=0, prepend=x[:1]) / np.diff(t, prepend=-np.inf)[:, None]
    if evidence.encoders is not None and encoders is not None:
        then = before[line.encoders]
        read, jac, _ = encoders.predict(x[then])
        var = np.square(np.einsum("nmm->nm", jac)) * np.einsum("nii->ni", moved[then])
        errors[line.encoders] = (evidence.encoders.values - read) / np.sqrt(
            encoders.sigma[then] + var
        )
    z = np.concatenate([x, rate], axis=1)[held]
    return Beliefs(
        z=z,
        cov=cov[held],
        nats=every,
        before=x[before],
        before_cov=moved[before],
        encoder_errors=errors,
        scale={},
        settings=settings,
        findings=findings,
    )


def find_image_width(features: Features, body: BodyModel) -> float:
    """Pixels that count as 1: the image's width if the body has it, else the largest coordinate."""
    if "image_width" in body.provenance:
        return float(body.provenance["image_width"])
    seen = [
        np.nanmax(np.abs(s.values)) for s in features.tracks.values() if np.isfinite(s.values).any()
    ]
    return float(max(seen, default=1.0))


def _learn_static_variances(
    encoders: GridSense | None, noise: Array, gains: Array
) -> tuple[Array, Array]:
    """σ_x (M,), and by how much (M,) rad² encoders then
    deviate from a static belief, beyond their noise (M,).

    σ_x is the motion variance with which the belief predicts
    the next reading best, at one of the gains (G,M).
    """
    if encoders is None:
        return noise, np.zeros(len(noise))
    x = np.where(np.isfinite(encoders.s[0]), encoders.s[0], 0.0)
    squares = np.zeros(gains.shape)
    for row in encoders.s[1:]:
        nu = np.where(np.isfinite(row), row - x, 0.0)
        squares += nu * nu
        x = x + gains * nu
    best = np.take_along_axis(gains, squares.argmin(axis=0)[None], 0)[0]
    count = np.isfinite(encoders.s[1:]).sum(axis=0)
    moved = np.maximum(squares.min(axis=0) / np.maximum(count, 1) - noise, 0.0)
    return noise * best / (1.0 - best), moved if encoders.model is None else np.zeros(len(noise))

"""The paper's model in any reading: Algorithm 1
(`estimation`'s) for many readings at once on the same log.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..estimation.methods.algorithm1 import (
    CodingDynamics,
    SensedErrors,
    descend_free_energy,
    evaluate_spatial_coherence,
)
from ..estimation.methods.kalman import filter_static_angles
from ..types import Array

DT = 0.05
"""s: the printed Δt."""
LAMBDA = 1.0
"""The printed λ."""
WIDEST_ANGLE_RAD = float(np.pi)
"""The paper's joint angles are from −π to π: a belief beyond has diverged."""
SIGMA_P = 1.0
"""rad²: the printed σ_p."""


@dataclass(frozen=True, eq=False)
class Map:
    """A Gaussian process with n samples x (n,M) rad: scales
    (M,) rad · weights (n,2) and mean (2,) px · scatter px.
    """

    x: Array
    scales: Array
    weights: Array
    mean: Array
    scatter: float

    def at(self, x: Array) -> Array:
        """Places (N,2) px at x (N,M) rad."""
        apart = ((x[:, None] - self.x) / self.scales) ** 2
        return np.asarray(np.exp(-0.5 * apart.sum(axis=2)) @ self.weights + self.mean)


@dataclass(frozen=True, eq=False)
class Signals:
    """Signals on the grid t (N,) s: encoders (N,M) rad and place (N,2) px, NaN where absent.

    hand (N,2) px while a touch is felt and the hand is seen, else NaN · delay (N,) s of that touch,
    seen − felt · true (N,M) rad: the true angles.
    """

    t: Array
    encoders: Array
    place: Array
    hand: Array
    delay: Array
    true: Array

    def error(self, x: Array, since: float) -> float:
        """Root mean square error (rad) of a belief (N,M) from `since` s on; NaN if it diverged."""
        return float(np.sqrt(np.mean((x - self.true)[self.t >= since] ** 2)))


@dataclass(frozen=True, eq=False)
class Touching:
    """Constants of g_t: a = a_1 a_2 · b_1 in 1/px² · b_2
    in 1/s² · σ_t · value of s_t: best, peak or touched.
    """

    a: float
    b1: float
    b2: float
    sigma: float
    value: str


@dataclass(frozen=True, eq=False)
class Case:
    """One run: encoders used (M,) · vision's map, and
    whether it is used · unit of σ_v px · touch or None.

    integration as in `readings` · start and prior (M,)
    rad · square: the encoders read x² · rate: λ, 1/s.
    """

    model: Map
    encoders: tuple[bool, ...]
    vision: bool
    unit: float
    integration: str
    start: Array
    prior: Array
    touch: Touching | None = None
    square: bool = False
    sigma_v: float = 5.0
    rate: float = LAMBDA


@dataclass(frozen=True, eq=False)
class Runs:
    """The beliefs of B runs at N instants: x (B,N,M) rad,
    NaN after divergence · errors (B,N,M+2) of the senses.
    """

    x: Array
    errors: Array


def run_printed_model(signals: Signals, cases: Sequence[Case]) -> Runs:
    """Algorithm 1, its errata applied, for every case on one log."""
    senses = CaseSenses(signals, cases)
    count = len(signals.t)
    joints = signals.encoders.shape[1]
    x = np.full((len(cases), count, joints), np.nan)
    errors = np.full((len(cases), count, joints + 2), np.nan)
    start, prior = (
        np.array([getattr(one, name) for one in cases], float) for name in ("start", "prior")
    )
    with np.errstate(all="ignore"):  # diverging runs end as NaN
        for k, step in enumerate(
            descend_free_energy(start, prior, count, senses.at, _printed_dynamics(cases, joints))
        ):
            x[:, k] = step.x
            errors[:, k] = step.errors[:, : joints + 2]
    gone = np.maximum.accumulate(~(np.abs(x).max(axis=2) <= WIDEST_ANGLE_RAD), axis=1)
    return Runs(np.where(gone[:, :, None], np.nan, x), errors)


def filter_encoders(signals: Signals, start: Array) -> Array:
    """The paper's Kalman filter (`estimation`'s) on the
    encoders alone: beliefs (N,M) rad from `start` (M,) rad.
    """
    return filter_static_angles(signals.encoders, start, SIGMA_P)[0]


def _printed_dynamics(cases: Sequence[Case], joints: int) -> CodingDynamics:
    """σ_x = 1, as printed, and each case's λ and integration."""
    return CodingDynamics(
        DT,
        np.ones((len(cases), joints)),
        np.array([one.rate for one in cases]),
        at_rest=np.array([one.integration != "printed" for one in cases]),
        implicit=np.array([one.integration == "implicit" for one in cases]),
    )


class CaseSenses:
    """What the senses of B cases say on one log: encoders
    (M), the effector's place in its unit (2), touch (1).
    """

    def __init__(self, signals: Signals, cases: Sequence[Case]) -> None:
        """Stack the cases' constants."""
        self.signals = signals
        self.encoders = np.array([one.encoders for one in cases], bool)
        self.sees = np.array([one.vision for one in cases], bool)[:, None]
        self.square = np.array([one.square for one in cases], bool)[:, None]
        self.unit = np.array([one.unit for one in cases], float)[:, None]
        models = [one.model for one in cases]
        self.samples = np.array([m.x for m in models])
        self.weights = np.array([m.weights for m in models])
        self.scales = np.array([m.scales for m in models])[:, None]
        self.mean = np.array([m.mean for m in models])
        touch = [one.touch or Touching(0.0, 0.0, 0.0, 1.0, "best") for one in cases]
        self.feels = np.array([one.touch is not None for one in cases])
        self.a, self.b1, self.b2 = (
            np.array([getattr(one, name) for one in touch]) for name in ("a", "b1", "b2")
        )
        self.value = np.array([one.value for one in touch])
        sigma_v = np.array([one.sigma_v for one in cases])
        sigma_t = np.array([one.sigma for one in touch])
        self.sigma = np.column_stack([np.ones(self.encoders.shape), sigma_v, sigma_v, sigma_t])

    def places(self, x: Array) -> tuple[Array, Array]:
        """g (B,2) px and its slope (B,2,M) px/rad at beliefs x (B,M)."""
        apart = (x[:, None] - self.samples) / self.scales
        kernel = np.exp(-0.5 * (apart**2).sum(axis=2))[:, :, None] * self.weights
        return kernel.sum(axis=1) + self.mean, -np.einsum(
            "bnd,bnm->bdm", kernel, apart / self.scales
        )

    def at(self, k: int, x: Array) -> SensedErrors:
        """The readings of instant k against beliefs x (B,M)."""
        g, slope = self.places(x)
        read = self.signals.encoders[k]
        encoders_off = np.where(self.encoders, read - np.where(self.square, x**2, x), np.nan)
        encoders_slope = np.where(self.square, 2.0 * x, 1.0)[:, :, None] * np.eye(x.shape[1])
        place_off = np.where(self.sees, (self.signals.place[k] - g) / self.unit, np.nan)
        touch_off, touch_slope = self.touch(k, g, slope)
        off = np.column_stack([encoders_off, place_off, touch_off])
        slopes = np.concatenate(
            [encoders_slope, slope / self.unit[:, :, None], touch_slope[:, None]], axis=1
        )
        return SensedErrors(off, slopes, self.sigma)

    def touch(self, k: int, g: Array, slope: Array) -> tuple[Array, Array]:
        """s_t − g_t (B,), NaN where nothing is felt, and ∂g_t/∂x (B,M)."""
        hand = self.signals.hand[k]
        delay = self.signals.delay[k]
        if not self.feels.any() or not np.isfinite(hand).all():
            return np.full(len(g), np.nan), np.zeros((len(g), slope.shape[2]))
        best = self.a * np.exp(-self.b2 * delay**2)
        g_t, pull = evaluate_spatial_coherence(g - hand, slope, best, self.b1)
        reading = np.select([self.value == "best", self.value == "peak"], [best, self.a], 1.0)
        return np.where(self.feels, reading - g_t, np.nan), pull

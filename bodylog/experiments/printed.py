"""The paper's model in any reading: Algorithm 1 for many readings at once on the same log.

It shares no code with `estimation/`, which runs one reading; a test holds the two to each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..types import Array

DT = 0.05
"""s: the printed Δt."""
LAMBDA = 1.0
"""The printed λ."""
FAR = 100.0
"""rad: a belief beyond this has diverged."""


@dataclass(frozen=True, eq=False)
class Map:
    """A Gaussian process with n samples x (n,M) rad: scales (M,) rad · weights (n,2) and mean (2,) px · scatter px."""

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

    hand (N,2) px while a touch is felt and the hand is seen, else NaN · delay (N,) s of that touch, seen − felt ·
    true (N,M) rad: the true angles.
    """

    t: Array
    encoders: Array
    place: Array
    hand: Array
    delay: Array
    true: Array

    def error(self, x: Array, since: float) -> float:
        """Root mean square error (rad) of a belief (N,M) from `since` s on; NaN when it diverged."""
        return float(np.sqrt(np.mean((x - self.true)[self.t >= since] ** 2)))


@dataclass(frozen=True, eq=False)
class Touching:
    """Constants of g_t: a = a_1 a_2 · b_1 in 1/px² · b_2 in 1/s² · σ_t · value of s_t: best, peak or touched."""

    a: float
    b1: float
    b2: float
    sigma: float
    value: str


@dataclass(frozen=True, eq=False)
class Case:
    """One run: encoders used (M,) · vision's map, and whether it is used · unit of σ_v px · touch or None.

    integration as in `readings` · start and prior (M,) rad · square: the encoders read x².
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


@dataclass(frozen=True, eq=False)
class Runs:
    """The beliefs of B runs at N instants: x (B,N,M) rad, NaN after divergence · errors (B,N,M+2) of the senses."""

    x: Array
    errors: Array


def believed(signals: Signals, cases: Sequence[Case]) -> Runs:
    """Algorithm 1, its errata applied, for every case on one log."""
    state = _State(signals, cases)
    x, errors = [], []
    with np.errstate(all="ignore"):  # diverging runs end as NaN
        for k in range(len(signals.t)):
            state.step(k)
            x.append(state.x.copy())
            errors.append(np.concatenate([state.ep, state.ev], axis=1))
    return Runs(np.stack(x, axis=1), np.stack(errors, axis=1))


class _State:
    """Beliefs of B cases, integrated together: x, μ, e_x, e_p (B,M), e_v (B,2), e_t (B,)."""

    def __init__(self, signals: Signals, cases: Sequence[Case]) -> None:
        self.signals, self.cases = signals, cases
        self.x, self.mu = (np.array([getattr(c, name) for c in cases], float) for name in ("start", "prior"))
        self.ex, self.ep = np.zeros_like(self.x), np.zeros_like(self.x)
        self.ev, self.et = np.zeros((len(cases), 2)), np.zeros(len(cases))
        self.encoders = np.array([c.encoders for c in cases], bool)
        self.seen, self.square = (np.array([getattr(c, n) for c in cases], bool)[:, None] for n in ("vision", "square"))
        self.unit, self.sigma_v = (
            np.array([getattr(c, n) for c in cases], float)[:, None] for n in ("unit", "sigma_v")
        )
        self.rest = np.array([c.integration != "printed" for c in cases])[:, None]
        self.implicit = np.array([c.integration == "implicit" for c in cases])
        models = [c.model for c in cases]
        self.samples, self.weights = np.array([m.x for m in models]), np.array([m.weights for m in models])
        self.scales, self.mean = np.array([m.scales for m in models])[:, None], np.array([m.mean for m in models])
        touch = [c.touch or Touching(0.0, 0.0, 0.0, 1.0, "best") for c in cases]
        self.feels = np.array([c.touch is not None for c in cases])
        self.a, self.b1, self.b2, self.sigma_t = (
            np.array([getattr(c, n) for c in touch]) for n in ("a", "b1", "b2", "sigma")
        )
        self.value = np.array([c.value for c in touch])

    def places(self) -> tuple[Array, Array]:
        """g (B,2) px and its slope (B,2,M) px/rad at the beliefs."""
        apart = (self.x[:, None] - self.samples) / self.scales
        kernel = np.exp(-0.5 * (apart**2).sum(axis=2))[:, :, None] * self.weights
        return kernel.sum(axis=1) + self.mean, -np.einsum("bnd,bnm->bdm", kernel, apart / self.scales)

    def step(self, k: int) -> None:
        """One Euler step; the belief before it drives the errors, as in Algorithm 1."""
        g, slope = self.places()
        off_p, lean = self._encoders(k)
        off_v = np.where(self.seen & np.isfinite(self.signals.place[k]), (self.signals.place[k] - g) / self.unit, 0.0)
        there = off_v != 0.0
        off_t, pull, felt = self._touch(k, g, slope)
        rest_p, rest_v, rest_t = off_p, off_v / self.sigma_v, off_t / self.sigma_t
        rest_x = self.x - self.mu
        ex, ep = np.where(self.rest, rest_x, self.ex), np.where(self.rest, rest_p, self.ep * (off_p != 0.0))
        ev, et = np.where(self.rest, rest_v, self.ev * there), np.where(self.rest[:, 0], rest_t, self.et * felt)
        force = -ex + lean * ep + np.einsum("bdm,bd->bm", slope / self.unit[:, :, None], ev) + pull * et[:, None]
        move = DT * force
        if self.implicit.any():
            move = np.where(
                self.implicit[:, None],
                self._implicit(force, lean * (off_p != 0.0), slope * there[:, :, None], pull),
                move,
            )
        follow = np.where(
            self.implicit[:, None], DT * LAMBDA / (1.0 + DT * LAMBDA) * (self.x + move - self.mu), DT * LAMBDA * ex
        )
        self.ex = ex + DT * (rest_x - ex)
        self.ep, self.ev = ep + DT * (off_p - ep), ev + DT * (off_v - self.sigma_v * ev)
        self.et = et + DT * felt * (off_t - self.sigma_t * et)
        self.x, self.mu = self.x + move, self.mu + follow
        self.x[~(np.abs(self.x).max(axis=1) < FAR)] = np.nan

    def _encoders(self, k: int) -> tuple[Array, Array]:
        """s_p − g_p (B,M), 0 where not used, and ∂g_p/∂x (B,M), which is diagonal."""
        read = self.signals.encoders[k]
        off = read - np.where(self.square, self.x**2, self.x)
        return np.where(self.encoders & np.isfinite(read), off, 0.0), np.where(self.square, 2.0 * self.x, 1.0)

    def _touch(self, k: int, g: Array, slope: Array) -> tuple[Array, Array, Array]:
        """s_t − g_t (B,), ∂g_t/∂x (B,M) and whether it is felt (B,)."""
        hand, delay = self.signals.hand[k], self.signals.delay[k]
        felt = self.feels & np.isfinite(hand).all() & np.isfinite(delay)
        apart = np.where(felt[:, None], g - hand, 0.0)
        best = self.a * np.exp(-self.b2 * (delay if np.isfinite(delay) else 0.0) ** 2)
        g_t = best * np.exp(-self.b1 * (apart**2).sum(axis=1))
        reading = np.select([self.value == "best", self.value == "peak"], [best, self.a], 1.0)
        pull = -2.0 * (self.b1 * g_t)[:, None] * np.einsum("bd,bdm->bm", apart, slope)
        return felt * (reading - g_t), felt[:, None] * pull, felt

    def _implicit(self, force: Array, lean: Array, slope: Array, pull: Array) -> Array:
        """(I + Δt H)⁻¹ Δt ∂F/∂x, H the Gauss–Newton Hessian (B,M,M)."""
        eye = np.eye(self.x.shape[1])
        noise = (self.sigma_v * self.unit**2)[:, :, None]
        hessian = eye + eye * (lean**2)[:, :, None] + np.einsum("bdm,bdn->bmn", slope / noise, slope)
        hessian = hessian + pull[:, :, None] * (pull / self.sigma_t[:, None])[:, None]
        finite = np.isfinite(hessian).all(axis=(1, 2))
        solved = np.linalg.solve(np.where(finite[:, None, None], eye + DT * hessian, eye), DT * force[:, :, None])[
            ..., 0
        ]
        return np.where(finite[:, None], solved, np.nan)

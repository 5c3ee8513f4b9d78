"""The paper's Algorithm 1 with its errata (docs/paper.md) corrected, for any senses and many runs
at once.

An explicit step integrates belief, errors and prior as printed. A step at equilibrium sets the
errors to what they tend to, (s − g)/σ. A linearly implicit one also divides by I + Δt·H, H the
Gauss–Newton Hessian, which is stable at any Δt.

Touch as printed in the paper: g_t = f_s f_t itself enters the prediction errors, not its logarithm.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ...body_model import BodyModel, ForwardModel, TouchConstants
from ...types import Array, Features
from ..measurements.long_arrays import find_finite_rows
from ..measurements.touch import find_strongest_touches

DIVERGENCE_RAD = 100.0
"""A belief beyond this has diverged: no joint turns 16 times."""


@dataclass(frozen=True, eq=False)
class PaperTouch:
    """On a grid: active (N,) · hand (N,2) px · f_t (N,)
    temporal coherence; with the model and constants it needs.
    """

    model: ForwardModel
    constants: TouchConstants
    active: Array
    hand: Array
    temporal: Array

    def measure_touch_error(self, k: int, x: Array) -> tuple[float, Array]:
        """s_t − g_t, s_t being g_t's best value, NaN where
        nothing is felt; and ∂g_t/∂x (M,) at step k and x (M,).
        """
        if not self.active[k]:
            return float("nan"), np.zeros(len(x))
        mean, jac, _ = self.model.predict(x[None])
        best = np.array([self.constants.a1 * self.temporal[k]])
        g, slope = evaluate_spatial_coherence(
            mean - self.hand[k], jac, best, np.array([self.constants.b1])
        )
        return float(best[0] - g[0]), slope[0]


def evaluate_spatial_coherence(
    apart: Array, jac: Array, best: Array, b1: Array
) -> tuple[Array, Array]:
    """g_t = best exp(−b₁ |g_v − o_v|²) (B,), best being
    a₁ f_t, and ∂g_t/∂x = −2 b₁ g_t (g_v − o_v)ᵀ J (B,M).

    apart (B,2): g_v − o_v · jac (B,2,M): J.
    """
    g = best * np.exp(-b1 * (apart**2).sum(axis=1))
    return g, -2.0 * (b1 * g)[:, None] * np.einsum("bd,bdm->bm", apart, jac)


def build_paper_touch(features: Features, body: BodyModel, t: Array, dt: float) -> PaperTouch:
    """Touch, of which there is a sighting, on the grid t (N,) s."""
    hand = features.hand
    assert hand is not None
    rows = np.maximum(np.searchsorted(hand.t, t + 1e-9, "right") - 1, 0)
    seen = find_finite_rows(hand.values[rows]) & (np.abs(t - hand.t[rows]) < max(dt, 0.2))
    temporal, _ = find_strongest_touches(features, t)
    return PaperTouch(
        body.senses["effector"], body.touch, seen & (temporal > 0), hand.values[rows], temporal
    )


@dataclass(frozen=True, eq=False)
class SensedErrors:
    """What R readings say about B beliefs at an instant: s
    − g (B,R), NaN where absent · ∂g/∂x̂ (B,R,M) · σ (B,R).
    """

    off: Array
    slope: Array
    sigma: Array

    def zero_absent_readings(self) -> "SensedErrors":
        """The same with absent readings as rows of zeros, which contribute nothing."""
        here = np.isfinite(self.off)
        return SensedErrors(
            np.where(here, self.off, 0.0),
            np.where(here[..., None], self.slope, 0.0),
            np.where(here, self.sigma, 1.0),
        )


@dataclass(frozen=True, eq=False)
class CodingDynamics:
    """Constants of B runs: Δt s · σ_x (B,M) · λ (B,) 1/s
    · who has errors at rest, and implicit steps (B,).
    """

    dt: float
    sigma_x: Array
    rate: Array
    at_rest: Array
    implicit: Array


@dataclass(frozen=True, eq=False)
class CodingStep:
    """One step of B runs: x̂ after it (B,M), NaN once diverged · errors e_i after it (B,R).

    before it: x̂ − μ (B,M), and what the senses said.
    """

    x: Array
    errors: Array
    prior_off: Array
    sensed: SensedErrors


def descend_free_energy(
    start: Array,
    prior: Array,
    count: int,
    sense: Callable[[int, Array], SensedErrors],
    dynamics: CodingDynamics,
) -> Iterator[CodingStep]:
    """`count` steps of B runs from beliefs `start` and prior
    beliefs (B,M) rad; fewer when all runs have diverged.

    sense(k, x): what the senses say at instant k about beliefs x (B,M).
    """
    x = start
    mu = prior
    prior_error = np.zeros(start.shape)
    errors = np.zeros(0)
    at_rest = dynamics.at_rest[:, None]
    rate = dynamics.rate[:, None]
    implicit = np.flatnonzero(dynamics.implicit)
    for k in range(count):
        sensed = sense(k, x)
        here = np.isfinite(sensed.off)
        present = sensed.zero_absent_readings()
        errors = np.where(here, errors, 0.0) if k else np.zeros(here.shape)
        prior_off = x - mu
        error = np.where(at_rest, present.off / present.sigma, errors)
        error_x = np.where(at_rest, prior_off / dynamics.sigma_x, prior_error)
        move = dynamics.dt * (np.einsum("brm,br->bm", present.slope, error) - error_x)
        # corrected: μ̇ = λ e_x, and ė_x = x̂ − μ − σ_x e_x
        prior_move = dynamics.dt * rate * error_x
        if len(implicit):
            hessian = build_gauss_newton_hessian(present, dynamics.sigma_x, implicit)
            move[implicit] = _divide_by_hessian(hessian, move[implicit], dynamics.dt)
            reach = dynamics.dt * rate[implicit]
            ahead = prior_off[implicit] + move[implicit]
            prior_move[implicit] = reach / (dynamics.sigma_x[implicit] + reach) * ahead
        prior_error = error_x + dynamics.dt * (prior_off - dynamics.sigma_x * error_x)
        errors = error + dynamics.dt * np.where(here, present.off - present.sigma * error, 0.0)
        x = x + move
        mu = mu + prior_move
        x = np.where((np.abs(x).max(axis=1) < DIVERGENCE_RAD)[:, None], x, np.nan)
        yield CodingStep(x, errors, prior_off, sensed)
        if not np.isfinite(x).any():
            return


def build_gauss_newton_hessian(present: SensedErrors, sigma_x: Array, runs: Array) -> Array:
    """H = 1/σ_x + Σ g′ᵀ g′/σ (K,M,M) of the free energy of `runs` (K,)."""
    slope = present.slope[runs]
    sigma = present.sigma[runs]
    prior = np.eye(slope.shape[2]) / sigma_x[runs][:, :, None]
    return np.asarray(prior + np.einsum("brm,brn->bmn", slope / sigma[..., None], slope))


def _divide_by_hessian(hessian: Array, move: Array, dt: float) -> Array:
    """(I + Δt H)⁻¹ of moves (K,M), NaN where H (K,M,M) is not finite."""
    eye = np.eye(move.shape[1])
    finite = np.asarray(np.isfinite(hessian).all(axis=(1, 2)))
    system = np.where(finite[:, None, None], eye + dt * hessian, eye)
    solved = np.linalg.solve(system, move[:, :, None])[..., 0]
    return np.where(finite[:, None], solved, np.nan)


def measure_stable_step(slope: Array, sigma: Array, sigma_x: Array, rate: float) -> float:
    """Largest Δt (s) for which one explicit step shrinks every mode, linearised at N postures.

    slope (N,R,M): ∂g/∂x̂ of R readings · sigma (N,R), sigma_x (M,): variances · rate: λ, 1/s.
    """
    n, _, m = slope.shape
    i = np.eye(m) + np.zeros((n, 1, 1))
    o = np.zeros((n, m, m))
    none = np.zeros_like(slope)
    # rows and columns: x, e_x, μ, the senses' errors
    a = np.block(
        [
            [o, -i, o, slope.swapaxes(1, 2)],
            [i, -sigma_x * i, -i, none.swapaxes(1, 2)],
            [o, rate * i, o, none.swapaxes(1, 2)],
            [-slope, none, none, -sigma[:, None] * np.eye(sigma.shape[1])],
        ]
    )
    modes = np.linalg.eigvals(a)
    modes = modes[modes.real < -1e-9]
    return float((-2.0 * modes.real / np.abs(modes) ** 2).min()) if len(modes) else np.inf

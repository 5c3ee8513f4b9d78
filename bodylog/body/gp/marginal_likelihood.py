"""Marginal likelihood of an SE-ARD Gaussian process
with constant mean, its gradient, and its maximum.
"""

from dataclasses import dataclass, field
from functools import cache
from math import isqrt
from typing import Any

import numpy as np

from ...bfgs import minimise_with_bfgs
from ...types import Array
from ..data.subsampling import choose_spaced_rows
from .model import se_kernel, variance_shares

_JITTER = 1e-10
_INFORMANTS = 100
_LEAST_INFORMATION = 0.1


@dataclass(frozen=True, eq=False)
class Hyper:
    """Kernel of one group of outputs: scales (M,) ·
    amplitude · noise, white variance beyond the known.
    """

    scales: Array
    amplitude: float
    noise: float

    @property
    def theta(self) -> Array:
        """Logarithms: amplitude, scales, noise."""
        return np.asarray(np.log(np.concatenate([[self.amplitude], self.scales, [self.noise]])))


def hyper_from_theta(theta: Array) -> Hyper:
    """The inverse of Hyper.theta."""
    values = np.exp(theta)
    return Hyper(values[1:-1], float(values[0]), float(values[-1]))


@dataclass(frozen=True, eq=False)
class Spread:
    """Known noise covariance of n samples: diagonal (n,)
    and entries value (L,) at rows i > columns j, each once.

    share (G,), of mean 1: factor of each output's own noise covariance over this one.
    """

    diagonal: Array
    i: Array
    j: Array
    value: Array
    share: Array = field(default_factory=lambda: np.ones(1))

    def scaled(self, factor: float) -> "Spread":
        """Return the same noise in other units."""
        return Spread(self.diagonal * factor, self.i, self.j, self.value * factor, self.share)


def independent_noise(diagonal: Array, white: float = 0.0) -> Spread:
    """Noise (n,) of all outputs, or (n,G) of each, without covariance between samples.

    white: variance of each output beyond it. It is the same for all, and
    where it is larger, it makes the outputs' shares more alike.
    """
    diagonal = diagonal.reshape(len(diagonal), -1)
    nothing = np.zeros(0, np.int64)
    share = variance_shares(diagonal + white)
    return Spread((diagonal / share).mean(axis=1), nothing, nothing, np.zeros(0), share)


@dataclass(frozen=True, eq=False)
class Posterior:
    """Exact posterior: alpha (n,G) = K⁻¹(y − mean) ·
    mean (G,) · chol (n,n) lower · evidence in nats.
    """

    alpha: Array
    mean: Array
    chol: Array
    evidence: float


@dataclass(frozen=True, eq=False)
class Prior:
    """Prior of length scales: log-normal about `scales` (M,) or (), relative width `width`."""

    scales: Array
    width: float

    def scaled(self, factor: Array) -> "Prior":
        """Return the same prior for inputs in other units."""
        return Prior(self.scales * factor, self.width)


FLAT = Prior(np.ones(()), np.inf)

# A point that turns about a joint is projected with autocovariance
# cos τ, whose curvature is that of l = 1 rad; perspective and further
# joints change that by less than a factor of two (two widths).
ROTATION = Prior(np.ones(()), 0.35)


def condition_gp(kernel: Hyper, x: Array, y: Array, spread: Spread) -> Posterior:
    """Posterior of outputs y (n,G) that share `kernel`, with known noise `spread`."""
    z = (x - x.mean(axis=0)) / kernel.scales
    return _condition_on_gram(se_kernel(z, z, kernel.amplitude), kernel.noise, y, spread)


def log_marginal_likelihood(
    theta: Array, x: Array, y: Array, spread: Spread
) -> tuple[float, Array]:
    """Log marginal likelihood (nats) at theta and its gradient;
    the constant mean is maximised out (R&W 2.30, 5.9).
    """
    return _likelihood_from_terms(theta, _kernel_terms(x), y, spread)


def _likelihood_from_terms(
    theta: Array, terms: Array, y: Array, spread: Spread
) -> tuple[float, Array]:
    """The same for inputs with precomputed terms."""
    kernel = np.exp(theta)
    group = y.shape[1]
    gram = _kernel_grams(theta, terms)
    found = _condition_on_gram(gram, kernel[-1], y, spread)
    inverse, _ = _import_lapack().dpotri(found.chol, lower=1, overwrite_c=1)
    # R&W 5.9: derivative by each entry of the covariance,
    # ααᵀ − G K⁻¹; one triangle, zeros in the other
    worth = _import_blas().dsyrk(1.0, found.alpha, beta=-group, c=inverse, lower=1, overwrite_c=1).T
    trace = worth.trace()
    worth *= gram
    gradient = np.empty(len(theta))
    gradient[:-1] = terms @ worth.reshape(-1)
    gradient[0] -= 0.5 * kernel[0] * trace
    gradient[1:-1] *= -2.0 / kernel[1:-1] ** 2
    gradient[-1] = 0.5 * kernel[-1] * trace
    return found.evidence, gradient


def maximise_evidence(x: Array, y: Array, spread: Spread, prior: Prior, starts: Array) -> Hyper:
    """The kernel of greatest evidence under the prior;
    x and y of order one, starts (S,M+2) in theta.

    One descent from the best start, with the Fisher information there as first curvature.
    """
    terms = _kernel_terms(x)
    low = np.array([-10.0, *[-5.0] * x.shape[1], -23.0])
    high = np.array([16.0, *[10.0] * x.shape[1], 3.0])
    thetas = np.minimum(np.maximum(starts, low), high)
    first = (
        thetas[0]
        if len(thetas) == 1
        else thetas[np.argmin(_losses_at_thetas(thetas, terms, y, spread, prior))]
    )
    curvature = _fisher_information(first, x, y.shape[1], spread, prior)
    return hyper_from_theta(
        minimise_with_bfgs(
            lambda theta: _negative_log_posterior(theta, terms, y, spread, prior),
            first,
            low,
            high,
            curvature,
        ).at
    )


def draw_kernel_starts(x: Array, seed: int, count: int) -> Array:
    """A typical first guess for x, y of order one, then
    seeded ones: as rough or smoother, as noisy or quieter.
    """
    draw = np.random.default_rng(seed)
    inputs = x.shape[1]
    jumps = np.zeros((count, inputs + 2))
    jumps[1:] = draw.normal(0.0, 0.4, (count - 1, inputs + 2))
    jumps[1:, 0] += draw.normal(0.5, 1.0, count - 1)
    jumps[1:, 1:-1] += draw.normal(0.0, 0.4, (count - 1, 1))
    jumps[1:, -1] = draw.uniform(-8.0, 0.0, count - 1)
    return Hyper(np.full(inputs, 2.0), 1.0, 1e-2).theta + jumps


def _negative_log_posterior(
    theta: Array, terms: Array, y: Array, spread: Spread, prior: Prior
) -> tuple[float, Array]:
    value, gradient = _likelihood_from_terms(theta, terms, y, spread)
    away = _distance_from_prior(theta, prior)
    gradient[1:-1] -= away / prior.width
    return 0.5 * float(away @ away) - value, -gradient


def _losses_at_thetas(
    thetas: Array, terms: Array, y: Array, spread: Spread, prior: Prior
) -> list[float]:
    """The loss alone, at several thetas (S,M+2)."""
    noises = np.exp(thetas[:, -1])
    grams = _kernel_grams(thetas, terms)
    fits = [
        _condition_on_gram(gram, noise, y, spread).evidence
        for gram, noise in zip(grams, noises, strict=True)
    ]
    return [
        0.5 * float(np.square(_distance_from_prior(t, prior)).sum()) - fit
        for t, fit in zip(thetas, fits, strict=True)
    ]


def _fisher_information(theta: Array, x: Array, group: int, spread: Spread, prior: Prior) -> Array:
    """Fisher information ½ tr(K⁻¹∂K K⁻¹∂K) of the G outputs
    and the prior (p,p), from at most 100 of the samples.
    """
    rows = choose_spaced_rows(len(x), _INFORMANTS)
    kernel = np.exp(theta)
    terms = _kernel_terms(x[rows])
    count = len(rows)
    gram = _kernel_grams(theta, terms)
    inverse = inverse_lower(
        cholesky_with_jitter(gram, independent_noise(spread.diagonal[rows]), kernel[-1])
    )
    bends = terms[1:].reshape(-1, count, count) * (-2.0 / kernel[1:-1, None, None] ** 2)
    slopes = np.array([gram, *(gram * bends), kernel[-1] * np.eye(count)])
    whitened = (inverse @ slopes @ inverse.T).reshape(len(theta), -1)
    found = 0.5 * group * len(x) / count * whitened @ whitened.T
    found[np.diag_indices(len(theta))] += _LEAST_INFORMATION
    found[range(1, len(theta) - 1), range(1, len(theta) - 1)] += prior.width**-2.0
    return np.asarray(found)


def _distance_from_prior(theta: Array, prior: Prior) -> Array:
    """Distance of each length scale from the prior's, in widths."""
    return np.asarray((theta[1:-1] - np.log(prior.scales)) / prior.width)


def _kernel_terms(x: Array) -> Array:
    """Terms of the kernel's logarithm: 1 and, for each input, −½ (xᵢ − xⱼ)²: (1+M,n²)."""
    terms = np.ones((1 + x.shape[1], len(x), len(x)))
    np.subtract(x.T[:, :, None], x.T[:, None], out=terms[1:])
    terms[1:] *= -0.5 * terms[1:]
    return terms.reshape(len(terms), -1)


def _kernel_grams(theta: Array, terms: Array) -> Array:
    """The kernel between all samples (n,n), or at several thetas (S,p) each: (S,n,n)."""
    shares = theta[..., :-1].copy()
    shares[..., 1:] = np.exp(-2.0 * shares[..., 1:])
    gram = shares @ terms
    count = isqrt(terms.shape[1])
    return np.asarray(np.exp(gram, out=gram).reshape(*theta.shape[:-1], count, count))


def _condition_on_gram(gram: Array, noise: float, y: Array, spread: Spread) -> Posterior:
    chol = cholesky_with_jitter(gram, spread, noise)
    sides = np.ones((len(y), y.shape[1] + 1), order="F")
    sides[:, 1:] = y
    solved, _ = _import_lapack().dpotrs(chol, sides, lower=1, overwrite_b=1)
    total = solved.sum(axis=0)
    mean = total[1:] / total[0]
    alpha = solved[:, 1:] - solved[:, :1] * mean
    fit = ((y - mean) * alpha).sum()
    entropy = y.shape[1] * (np.log(chol.diagonal()).sum() + 0.5 * len(y) * np.log(2.0 * np.pi))
    return Posterior(alpha, mean, chol, float(-0.5 * fit - entropy))


def cholesky_with_jitter(gram: Array, spread: Spread, noise: float) -> Array:
    """Lower factor (n,n) of gram + spread + noise I,
    zeros above; jitter grows tenfold until it exists.
    """
    count = len(gram)
    dpotrf = _import_lapack().dpotrf
    diagonal = spread.diagonal + noise
    jitter = _JITTER * float(gram[0, 0] or diagonal[0])
    for _ in range(9):
        matrix = gram.copy()
        matrix.reshape(-1)[:: count + 1] += diagonal + jitter
        if len(spread.i):
            matrix[spread.j, spread.i] += spread.value
        # the transpose is in LAPACK's order, and equal by symmetry
        chol, failed = dpotrf(matrix.T, lower=1, overwrite_a=1)
        if not failed:
            return np.asarray(chol)
        jitter *= 10.0
    raise np.linalg.LinAlgError(f"the kernel of {count} samples is not positive definite")


def inverse_lower(chol: Array) -> Array:
    """Inverse (n,n) of a lower triangular factor."""
    return np.ascontiguousarray(_import_lapack().dtrtri(chol, lower=1)[0])


@cache
def _import_lapack() -> Any:
    from scipy.linalg import lapack

    return lapack


@cache
def _import_blas() -> Any:
    from scipy.linalg import blas

    return blas

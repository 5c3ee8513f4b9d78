"""Marginal likelihood of an SE-ARD Gaussian process with constant mean, its gradient, and what maximises it."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from ..types import Array

_JITTER = 1e-10


@dataclass(frozen=True, eq=False)
class Hyper:
    """Kernel of one group of outputs: scales (M,) · amplitude · noise, white variance beyond the known."""

    scales: Array
    amplitude: float
    noise: float

    @property
    def theta(self) -> Array:
        """Logarithms: amplitude, scales, noise."""
        return np.asarray(np.log(np.concatenate([[self.amplitude], self.scales, [self.noise]])))


def hyper(theta: Array) -> Hyper:
    """The inverse of Hyper.theta."""
    values = np.exp(theta)
    return Hyper(values[1:-1], float(values[0]), float(values[-1]))


@dataclass(frozen=True, eq=False)
class Spread:
    """Known noise covariance of n samples: diagonal (n,) and entries value (L,) at rows i > columns j, each once."""

    diagonal: Array
    i: Array
    j: Array
    value: Array

    def scaled(self, factor: float) -> "Spread":
        """The same in other units."""
        return Spread(self.diagonal * factor, self.i, self.j, self.value * factor)


def independent(diagonal: Array) -> Spread:
    """Noise without covariance between samples."""
    nothing = np.zeros(0, np.int64)
    return Spread(diagonal, nothing, nothing, np.zeros(0))


@dataclass(frozen=True, eq=False)
class Posterior:
    """Exact posterior: alpha (n,G) = K⁻¹(y − mean) · mean (G,) · chol (n,n) lower · evidence in nats."""

    alpha: Array
    mean: Array
    chol: Array
    evidence: float


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of length scales beforehand: log-normal about `scales` (M,) or (), relative width `width`."""

    scales: Array
    width: float

    def scaled(self, factor: Array) -> "Prior":
        """The same for inputs in other units."""
        return Prior(self.scales * factor, self.width)


FLAT = Prior(np.ones(()), np.inf)

# A point that turns about a joint is projected with autocovariance cos τ, whose curvature is that of l = 1 rad;
# perspective and the joints beyond change that by less than a factor of two (two widths).
ROTATION = Prior(np.ones(()), 0.35)


def condition(kernel: Hyper, x: Array, y: Array, spread: Spread) -> Posterior:
    """Posterior of outputs y (n,G) that share `kernel`, with known noise `spread`."""
    return _condition(_gram(kernel.amplitude, (x - x.mean(axis=0)) / kernel.scales), kernel, y, spread)


def evidence(theta: Array, x: Array, y: Array, spread: Spread) -> tuple[float, Array]:
    """Log marginal likelihood (nats) at theta and its gradient; the constant mean is maximised out (R&W 2.30, 5.9)."""
    kernel, (count, group) = hyper(theta), y.shape
    z = np.ones((count, x.shape[1] + 1))
    z[:, 1:] = (x - x.mean(axis=0)) / kernel.scales
    gram = _gram(kernel.amplitude, z[:, 1:])
    found = _condition(gram, kernel, y, spread)
    inverse = _lapack().dpotri(found.chol, lower=1, overwrite_c=1)[0]
    diagonal = inverse.ravel(order="F")[:: count + 1].copy()
    trace = np.vdot(found.alpha, found.alpha) - group * diagonal.sum()
    fits = gram @ (found.alpha[:, :, None] * z[:, None, :]).reshape(count, -1)
    pull = (found.alpha[:, :, None] * fits.reshape(count, group, -1)).sum(axis=1)
    # the factor leaves zeros above the diagonal: the lower triangle and its transpose, less the diagonal once
    inverse *= gram.T
    rows = pull - group * (inverse @ z + inverse.T @ z - (kernel.amplitude * diagonal)[:, None] * z)
    # Σ P (zᵢ − zⱼ)² = 2 zᵢ² Σⱼ P − 2 zᵢ P zⱼ for symmetric P
    turned = (z * (z * rows[:, :1] - rows)).sum(axis=0)
    gradient = np.concatenate([[0.5 * rows[:, 0].sum()], turned[1:], [0.5 * kernel.noise * trace]])
    return found.evidence, gradient


def maximise(x: Array, y: Array, spread: Spread, prior: Prior, starts: list[Hyper]) -> Hyper:
    """The kernel of greatest evidence under the prior; x and y of order one.

    L-BFGS-B takes five steps from each start, and from the best of where they lead goes on until it settles.
    """
    thetas = [start.theta for start in starts]
    if len(thetas) > 1:
        thetas = [min((_descend(t, x, y, spread, prior, 5) for t in thetas), key=lambda found: found.fun).x]
    return hyper(_descend(thetas[0], x, y, spread, prior, 200).x)


def _descend(theta: Array, x: Array, y: Array, spread: Spread, prior: Prior, steps: int) -> Any:
    from scipy.optimize import minimize

    bounds = [(-10.0, 16.0)] + [(-5.0, 10.0)] * x.shape[1] + [(-23.0, 3.0)]
    first, options = np.clip(theta, *np.transpose(bounds)), {"maxiter": steps, "ftol": 1e-9}
    return minimize(_loss, first, (x, y, spread, prior), "L-BFGS-B", True, bounds=bounds, options=options)


def starts(x: Array, seed: int, count: int) -> list[Hyper]:
    """A typical first guess for x, y of order one, then seeded ones around it."""
    draw = np.random.default_rng(seed)
    first = Hyper(np.full(x.shape[1], 2.0), 1.0, 1e-2)
    jumps = draw.normal(0.0, 1.0, (count - 1, x.shape[1] + 2))
    return [first, *(hyper(first.theta + jump) for jump in jumps)]


def _loss(theta: Array, x: Array, y: Array, spread: Spread, prior: Prior) -> tuple[float, Array]:
    value, gradient = evidence(theta, x, y, spread)
    away = (theta[1:-1] - np.log(prior.scales)) / prior.width
    gradient[1:-1] -= away / prior.width
    return 0.5 * float(away @ away) - value, -gradient


def _gram(amplitude: float, z: Array) -> Array:
    half = 0.5 * (np.log(amplitude) - np.einsum("nm,nm->n", z, z))
    gram = z @ z.T
    gram += half[:, None]
    gram += half
    return np.asarray(np.exp(gram, out=gram))


def _condition(gram: Array, kernel: Hyper, y: Array, spread: Spread) -> Posterior:
    chol = cholesky(gram, spread, kernel.noise)
    sides = np.ones((len(y), y.shape[1] + 1), order="F")
    sides[:, 1:] = y
    solved = _lapack().dpotrs(chol, sides, lower=1, overwrite_b=1)[0]
    mean = solved[:, 1:].sum(axis=0) / solved[:, 0].sum()
    alpha = solved[:, 1:] - solved[:, :1] * mean
    fit = np.vdot(y - mean, alpha)
    entropy = y.shape[1] * (np.log(chol.diagonal()).sum() + 0.5 * len(y) * np.log(2.0 * np.pi))
    return Posterior(alpha, mean, chol, float(-0.5 * fit - entropy))


def cholesky(gram: Array, spread: Spread, noise: float) -> Array:
    """Lower factor (n,n) of gram + spread + noise I, zeros above; jitter grows tenfold until it exists."""
    count, dpotrf = len(gram), _lapack().dpotrf
    diagonal = spread.diagonal + noise
    jitter = _JITTER * float(gram.trace() or diagonal.sum()) / count
    for _ in range(9):
        matrix = gram.copy()
        matrix.ravel()[:: count + 1] += diagonal + jitter
        if len(spread.i):
            matrix[spread.j, spread.i] += spread.value
        # its transpose is in LAPACK's order, and as it is symmetric, the same
        chol, failed = dpotrf(matrix.T, lower=1, overwrite_a=1)
        if not failed:
            return np.asarray(chol)
        jitter *= 10.0
    raise np.linalg.LinAlgError(f"the kernel of {count} samples is not positive definite")


def inverse_lower(chol: Array) -> Array:
    """Inverse (n,n) of a lower triangular factor."""
    return np.ascontiguousarray(_lapack().dtrtri(chol, lower=1)[0])


@cache
def _lapack() -> Any:
    from scipy.linalg import lapack

    return lapack

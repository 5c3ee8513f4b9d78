"""Posterior on inducing points: Titsias' collapsed
bound in closed form, summed over blocks of data.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from ...types import Array
from ..data.subsampling import choose_pivot_rows, choose_spaced_rows
from .marginal_likelihood import (
    Hyper,
    Spread,
    cholesky_with_jitter,
    independent_noise,
    inverse_lower,
)
from .model import se_kernel

_MOST = 400
_POOL = 20_000
_CHUNK = 1024
_TOLERANCE = 1e-11


@dataclass(frozen=True, eq=False)
class Basis:
    """A kernel on inducing points (m,M) rad, with the inverse factor (m,m) of their Gram matrix."""

    kernel: Hyper
    centres: Array
    inverse: Array


@dataclass(frozen=True, eq=False)
class Sums:
    """Sufficient sums of the data: outer (m,m), cross
    (m,1+G), inner (1+G,1+G), ln|C|, lost trace, samples.
    """

    outer: Array
    cross: Array
    inner: Array
    logdet: float
    lost: float
    count: int

    def plus(self, other: "Sums", sign: int = 1) -> "Sums":
        """Add the sums of another data set; subtract them for sign −1."""
        return Sums(
            self.outer + sign * other.outer,
            self.cross + sign * other.cross,
            self.inner + sign * other.inner,
            self.logdet + sign * other.logdet,
            self.lost + sign * other.lost,
            self.count + sign * other.count,
        )


@dataclass(frozen=True, eq=False)
class Sparse:
    """weights (G,m) · factor (m,m) of GP · mean (G,) ·
    bound on the evidence, nats (Titsias 2009, eq. 9).
    """

    weights: Array
    factor: Array
    mean: Array
    bound: float


def choose_inducing_points(kernels: Sequence[Hyper], x: Array, noise: float) -> Array:
    """At most 400 points among x (n,M) rad that leave a
    hundredth of `noise` / n in the roughest of the kernels.

    Then n samples with such noise differ from the exact
    posterior by less than 0.01 nats (Burt et al. 2019).
    """
    pool = x[choose_spaced_rows(len(x), _POOL)]
    scales = np.min([k.scales for k in kernels], axis=0)
    amplitude = max(k.amplitude for k in kernels)
    return np.asarray(
        pool[
            choose_pivot_rows(
                pool / scales, _MOST, max(0.01 * noise / (len(x) * amplitude), _TOLERANCE)
            )
        ]
    )


def build_basis(kernel: Hyper, centres: Array) -> Basis:
    """The kernel on inducing points (m,M) rad."""
    gram = se_kernel(centres / kernel.scales, centres / kernel.scales, kernel.amplitude)
    return Basis(
        kernel,
        centres,
        inverse_lower(cholesky_with_jitter(gram, independent_noise(np.zeros(len(centres))), 0.0)),
    )


def sufficient_sums(base: Basis, x: Array, y: Array, spread: Spread) -> Sums:
    """Sums over samples x (n,M), y (n,G) with known noise
    `spread`, whose couplings end at each 1024th sample.
    """
    return reduce(
        Sums.plus,
        (_chunk_sums(base, x[rows], y[rows], part) for rows, part in _split_into_chunks(spread)),
    )


def sparse_posterior(base: Basis, total: Sums) -> Sparse:
    """The best Gaussian on the inducing points, with the constant mean of greatest likelihood."""
    values, vectors = np.linalg.eigh(total.outer)
    values = np.maximum(values, 0.0)
    turned = vectors.T @ base.inverse
    cross = vectors.T @ total.cross
    inner = total.inner - cross.T @ (cross / (1.0 + values)[:, None])
    mean = inner[0, 1:] / inner[0, 0]
    weights = turned.T @ ((cross[:, 1:] - cross[:, :1] * mean) / (1.0 + values)[:, None])
    factor = np.sqrt(values / (1.0 + values))[:, None] * turned
    group = len(mean)
    fit = float(np.trace(inner[1:, 1:]) - inner[0, 0] * mean @ mean)
    entropy = group * (
        total.logdet + np.log1p(values).sum() + total.count * np.log(2.0 * np.pi) + total.lost
    )
    return Sparse(weights.T, factor, mean, -0.5 * (fit + float(entropy)))


def sparse_held_out_residuals(
    base: Basis, x: Array, y: Array, spread: Spread, blocks: Sequence[Array]
) -> tuple[Array, Array]:
    """Residual (n,G) of each sample predicted without its
    block of rows, and its variance (n,), noise included.
    """
    parts = [
        sufficient_sums(base, x[rows], y[rows], noise_of_rows(spread, rows)) for rows in blocks
    ]
    total = reduce(Sums.plus, parts)
    residual = np.empty(y.shape)
    variance = spread.diagonal + base.kernel.noise + base.kernel.amplitude
    for rows, part in zip(blocks, parts, strict=True):
        found = sparse_posterior(base, total.plus(part, -1))
        cross = _cross_kernel(base, x[rows])
        residual[rows] = y[rows] - cross @ found.weights.T - found.mean
        variance[rows] -= np.square(cross @ found.factor.T).sum(axis=1)
    return residual, variance


def standardised_residuals(base: Basis, found: Sparse, x: Array, y: Array, spread: Spread) -> Array:
    """Residual (n,G) of samples y (n,G) at x (n,M) in standard deviations, noise included."""
    cross = _cross_kernel(base, x)
    variance = spread.diagonal + base.kernel.noise + base.kernel.amplitude
    variance = variance - np.square(cross @ found.factor.T).sum(axis=1)
    return np.asarray((y - cross @ found.weights.T - found.mean) / np.sqrt(variance)[:, None])


def _chunk_sums(base: Basis, x: Array, y: Array, spread: Spread) -> Sums:
    # whiten before summing: the sum would square the condition number of the Gram matrix
    cross = _cross_kernel(base, x) @ base.inverse.T
    sides = np.column_stack([np.ones(len(y)), y])
    seen = np.square(cross).sum(axis=1)
    if len(spread.i):
        chol = cholesky_with_jitter(np.zeros((len(x), len(x))), spread, base.kernel.noise)
        inverse = inverse_lower(chol)
        cross = inverse @ cross
        sides = inverse @ sides
        logdet = 2.0 * float(np.log(np.diag(chol)).sum())
    else:
        root = np.sqrt(spread.diagonal + base.kernel.noise)
        cross = cross / root[:, None]
        sides = sides / root[:, None]
        logdet = 2.0 * float(np.log(root).sum())
    left = np.maximum(base.kernel.amplitude - seen, 0.0)
    lost = float((left / (spread.diagonal + base.kernel.noise)).sum())
    return Sums(cross.T @ cross, cross.T @ sides, sides.T @ sides, logdet, lost, len(x))


def _cross_kernel(base: Basis, x: Array) -> Array:
    return se_kernel(
        x / base.kernel.scales, base.centres / base.kernel.scales, base.kernel.amplitude
    )


def _split_into_chunks(spread: Spread) -> Iterator[tuple[slice, Spread]]:
    for start in range(0, len(spread.diagonal), _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, len(spread.diagonal)))
        yield slice(start, start + len(rows)), noise_of_rows(spread, rows)


def noise_of_rows(spread: Spread, rows: Array) -> Spread:
    """The noise of some rows."""
    place = np.full(len(spread.diagonal), -1)
    place[rows] = np.arange(len(rows))
    i = place[spread.i]
    j = place[spread.j]
    kept = (i >= 0) & (j >= 0)
    return Spread(spread.diagonal[rows], i[kept], j[kept], spread.value[kept], spread.share)

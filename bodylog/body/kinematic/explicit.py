"""Residuals of a mean with linear unknowns z ~ N(0,
I): r = B z + g(x) + noise, z marginalised (R&W 2.7).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...bfgs import minimise_with_bfgs
from ...types import Array
from ..data.subsampling import choose_spaced_rows
from ..gp.inducing import Basis, noise_of_rows, sufficient_sums
from ..gp.marginal_likelihood import (
    Hyper,
    Prior,
    Spread,
    _fisher_information,
    _import_lapack,
    _kernel_grams,
    _kernel_terms,
    cholesky_with_jitter,
    draw_kernel_starts,
    hyper_from_theta,
)

_SCOUTS = 120
_GUESSES = 8
SEARCHED = 300
"""Most samples in the search for a kernel: a residual is smooth, and the evidence costs O(n³)."""


@dataclass(frozen=True, eq=False)
class ResidualRows:
    """Residuals r (n,D) px of samples at x (n,M) rad and
    their derivatives by z (n,D,P) px; known noise `spread`.
    """

    x: Array
    residual: Array
    design: Array
    spread: Spread

    def some(self, rows: Array) -> "ResidualRows":
        """Return some rows."""
        return ResidualRows(
            self.x[rows], self.residual[rows], self.design[rows], noise_of_rows(self.spread, rows)
        )


def search_residual_kernel(data: ResidualRows, prior: Prior, seed: int) -> Hyper:
    """The kernel of greatest evidence, and the white
    noise beyond the known, with z marginalised.
    """
    deviation = np.maximum(data.x.std(axis=0), 1e-9)
    unit = max(float(np.median(np.abs(data.residual))) / 0.6745, 1e-6)
    spread = data.spread.scaled(unit**-2.0)
    scaled = ResidualRows(data.x / deviation, data.residual / unit, data.design / unit, spread)
    prior = prior.scaled(1.0 / deviation)
    few, many = (thin_rows(scaled, count) for count in (_SCOUTS, SEARCHED))
    terms = _kernel_terms(few.x)
    guesses = draw_kernel_starts(few.x, seed, _GUESSES)
    losses = [_residual_loss(theta, terms, few, prior)[0] for theta in guesses]
    best = _climb_evidence(guesses[int(np.argmin(losses))], few, prior)
    if len(many.x) > len(few.x):
        best = _climb_evidence(best.theta, many, prior)
    return Hyper(best.scales * deviation, best.amplitude * unit**2, best.noise * unit**2)


def thin_rows(data: ResidualRows, count: int) -> ResidualRows:
    """At most `count` rows, evenly spaced."""
    rows = choose_spaced_rows(len(data.x), count)
    return data if len(rows) == len(data.x) else data.some(rows)


def _climb_evidence(first: Array, data: ResidualRows, prior: Prior) -> Hyper:
    inputs = data.x.shape[1]
    terms = _kernel_terms(data.x)
    low = np.array([-10.0, *[-5.0] * inputs, -23.0])
    high = np.array([16.0, *[10.0] * inputs, 6.0])
    first = np.clip(first, low, high)
    curvature = _fisher_information(first, data.x, data.residual.shape[1], data.spread, prior)
    return hyper_from_theta(
        minimise_with_bfgs(
            lambda theta: _residual_loss(theta, terms, data, prior), first, low, high, curvature
        ).at
    )


def residual_evidence(theta: Array, data: ResidualRows) -> tuple[float, Array]:
    """Log marginal likelihood (nats) at theta (as
    Hyper.theta), z and g marginalised, and its gradient.
    """
    return _residual_evidence_from_terms(theta, _kernel_terms(data.x), data)


def _residual_loss(
    theta: Array, terms: Array, data: ResidualRows, prior: Prior
) -> tuple[float, Array]:
    value, gradient = _residual_evidence_from_terms(theta, terms, data)
    away = (theta[1:-1] - np.log(prior.scales)) / prior.width
    gradient[1:-1] -= away / prior.width
    return 0.5 * float(away @ away) - value, -gradient


def _residual_evidence_from_terms(
    theta: Array, terms: Array, data: ResidualRows
) -> tuple[float, Array]:
    kernel = np.exp(theta)
    gram = _kernel_grams(theta, terms)
    chol = cholesky_with_jitter(gram, data.spread, kernel[-1])
    found = solve_linear_unknowns(chol, data)
    worth = evidence_derivative(chol, found)
    trace = float(np.trace(worth))
    worth *= gram
    gradient = np.empty(len(theta))
    gradient[:-1] = 0.5 * (terms @ worth.reshape(-1))
    gradient[0] = 0.5 * float(worth.sum())
    gradient[1:-1] *= -2.0 / kernel[1:-1] ** 2
    gradient[-1] = 0.5 * kernel[-1] * trace
    return found.evidence, gradient


def evidence_derivative(chol: Array, found: "LinearPosterior") -> Array:
    """Twice the derivative (n,n) of the evidence by the
    covariance, nats: αα' + C⁻¹B H⁻¹ B'C⁻¹ − D C⁻¹ (R&W 5.9).
    """
    columns = np.concatenate(
        [found.alpha.T, (found.lean @ found.root).transpose(0, 2, 1).reshape(-1, len(chol))]
    )
    return np.asarray(columns.T @ columns - len(found.lean) * inverse_from_cholesky(chol))


def inverse_from_cholesky(chol: Array) -> Array:
    """The inverse (n,n) of a matrix with this lower factor."""
    inverse = _import_lapack().dpotri(chol, lower=1)[0]
    return np.asarray(inverse + np.tril(inverse, -1).T)


@dataclass(frozen=True, eq=False)
class LinearPosterior:
    """z's posterior: mean (P,) and root (P,P), with covariance
    root rootᵀ · alpha (n,D), lean (D,n,P) · evidence.

    alpha = C⁻¹(r − B z) and lean = C⁻¹B are of outputs in units of their own share of the noise.
    """

    mean: Array
    root: Array
    alpha: Array
    lean: Array
    evidence: float


def solve_linear_unknowns(chol: Array, data: ResidualRows) -> LinearPosterior:
    """The posterior of z and g for the factor (n,n)
    of kernel and noise, and the evidence in nats.
    """
    count, outputs, unknowns = data.design.shape
    own = np.sqrt(data.spread.share)
    residual = data.residual / own
    design = data.design / own[:, None]
    sides = np.concatenate([residual, design.reshape(count, -1)], axis=1)
    back = np.asarray(_import_lapack().dpotrs(chol, np.asfortranarray(sides), lower=1)[0])
    lean = back[:, outputs:].reshape(count, outputs, unknowns).transpose(1, 0, 2)
    right = np.einsum("nd,dnp->p", residual, lean)
    mean, root, logdet = posterior_of_unknowns(np.einsum("ndp,dnq->pq", design, lean), right)
    alpha = back[:, :outputs] - np.einsum("dnp,p->nd", lean, mean)
    fit = float((residual * back[:, :outputs]).sum() - right @ mean)
    entropy = outputs * (2.0 * float(np.log(np.diag(chol)).sum()) + count * np.log(2.0 * np.pi))
    entropy += count * float(np.log(data.spread.share).sum()) * (len(data.spread.share) == outputs)
    return LinearPosterior(mean, root, alpha, lean, -0.5 * (fit + entropy + logdet))


def shared_evidence(parts: Sequence[tuple[Array, ResidualRows]]) -> float:
    """The evidence (nats) of several things that share
    z, each with its factor (n,n) of kernel and noise.
    """
    total = parts[0][1].design.shape[2]
    fit = 0.0
    entropy = 0.0
    pull = np.zeros(total)
    information = np.zeros((total, total))
    for chol, data in parts:
        count, outputs, unknowns = data.design.shape
        own = np.sqrt(np.broadcast_to(data.spread.share, outputs))
        residual = data.residual / own
        design = data.design / own[:, None]
        sides = np.concatenate([residual, design.reshape(count, -1)], axis=1)
        back = np.asarray(_import_lapack().dpotrs(chol, np.asfortranarray(sides), lower=1)[0])
        lean = back[:, outputs:].reshape(count, outputs, unknowns)
        fit = fit + float((residual * back[:, :outputs]).sum())
        pull = pull + np.einsum("nd,ndp->p", residual, lean)
        information = information + np.einsum("ndp,ndq->pq", design, lean)
        entropy = entropy + outputs * (
            2.0 * float(np.log(np.diag(chol)).sum()) + count * np.log(2.0 * np.pi)
        )
        entropy = entropy + 2.0 * count * float(np.log(own).sum())
    mean, _, logdet = posterior_of_unknowns(information, pull)
    return float(-0.5 * (fit - pull @ mean + entropy + logdet))


def posterior_of_unknowns(information: Array, pull: Array) -> tuple[Array, Array, float]:
    """z's mean (P,), root (P,P) and log determinant of
    its precision, from B'C⁻¹B (P,P) and B'C⁻¹r (P,).
    """
    values, vectors = np.linalg.eigh(information + np.eye(len(pull)))
    values = np.maximum(values, 1.0)
    root = vectors / np.sqrt(values)
    return root @ (root.T @ pull), root, float(np.log(values).sum())


def hold_out_blocks(chol: Array, data: ResidualRows, blocks: Array) -> tuple[Array, Array]:
    """Residual (n,D) of each sample predicted without its
    block (n,), and its variance (n,D), noise included.
    """
    count, outputs = data.residual.shape
    found = solve_linear_unknowns(chol, data)
    own = np.sqrt(np.broadcast_to(data.spread.share, outputs))
    inverse = inverse_from_cholesky(chol)
    lean = (found.lean @ found.root).reshape(outputs * count, -1)
    residual, variance = np.empty((2, count, outputs))
    for label in np.unique(blocks):
        rows = np.flatnonzero(blocks == label)
        both = np.concatenate([d * count + rows for d in range(outputs)])
        inner = np.kron(np.eye(outputs), inverse[np.ix_(rows, rows)]) - lean[both] @ lean[both].T
        inner = np.linalg.inv(inner)
        residual[rows] = (inner @ found.alpha.T.reshape(-1)[both]).reshape(outputs, -1).T * own
        variance[rows] = np.diag(inner).reshape(outputs, -1).T * np.square(own)
    return residual, variance


@dataclass(frozen=True, eq=False)
class Condensed:
    """The same posterior on inducing points, in px: weights
    (D,m) of r − B z · lean (D,P,m) of B · factor (r,m) of GP.

    information (P,P) and pull (P,): the samples' information on z.
    """

    weights: Array
    lean: Array
    factor: Array
    information: Array
    pull: Array


def condense_posterior(base: Basis, data: ResidualRows) -> Condensed:
    """The posterior on inducing points, with weights for r alone, as for zero z."""
    count, outputs, unknowns = data.design.shape
    own = np.sqrt(np.broadcast_to(data.spread.share, outputs))
    sides = np.concatenate(
        [data.residual / own, (data.design / own[:, None]).reshape(count, -1)], axis=1
    )
    total = sufficient_sums(base, data.x, sides, data.spread)
    values, vectors = np.linalg.eigh(total.outer)
    values = np.maximum(values, 0.0)
    turned = vectors.T @ base.inverse
    cross = vectors.T @ total.cross[:, 1:]
    inner = total.inner[1:, 1:] - cross.T @ (cross / (1.0 + values)[:, None])
    weights = (turned.T @ (cross / (1.0 + values)[:, None])).T
    blocks = [slice(outputs + d * unknowns, outputs + (d + 1) * unknowns) for d in range(outputs)]
    lean = np.array([weights[b] for b in blocks]) * own[:, None, None]
    information = np.sum([inner[b, b] for b in blocks], axis=0)
    pull = np.sum([inner[b, d] for d, b in enumerate(blocks)], axis=0)
    factor = np.sqrt(values / (1.0 + values))[:, None] * turned
    return Condensed(weights[:outputs] * own[:, None], lean, factor, information, pull)

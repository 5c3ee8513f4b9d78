"""Held-out residuals without refitting: leave one block
of time out, in closed form (R&W 5.12; sums if sparse).
"""

import numpy as np

from ...types import Array
from . import inducing
from .fit import EXACT, FittedKernels, Samples, inducing_bases
from .marginal_likelihood import condition_gp, inverse_lower


def held_out_residuals(data: Samples, found: FittedKernels, block: Array) -> tuple[Array, Array]:
    """Residual (n,D) of each sample predicted without its
    block, and its predicted variance (n,D), noise included.
    """
    residual = np.empty(data.y.shape)
    variance = np.empty(data.y.shape)
    blocks = [np.flatnonzero(block == label) for label in np.unique(block)]
    for index, group in enumerate(found.groups):
        left_out = _hold_out_exact if len(data.x) <= EXACT else _hold_out_sparse
        residual[:, group], spread = left_out(data, found, index, blocks)
        variance[:, group] = spread[:, None] * found.spreads[index].share
    return residual, variance


def leave_one_out_deviations(data: Samples, found: FittedKernels) -> Array:
    """Each sample's leave-one-out residual (n,D) in
    deviations; on inducing points it is left in, one of many.
    """
    result = np.empty(data.y.shape)
    for index, group in enumerate(found.groups):
        kernel = found.kernels[index]
        spread = found.spreads[index]
        y = data.y[:, group]
        if len(data.x) <= EXACT:
            whole = condition_gp(kernel, data.x, y, spread)
            own = np.square(inverse_lower(whole.chol)).sum(axis=0)
            result[:, group] = whole.alpha / np.sqrt(own)[:, None]
        else:
            base = inducing_bases(data, found)[index]
            fit = inducing.sparse_posterior(base, inducing.sufficient_sums(base, data.x, y, spread))
            result[:, group] = inducing.standardised_residuals(base, fit, data.x, y, spread)
        result[:, group] /= np.sqrt(spread.share)
    return result


def _hold_out_exact(
    data: Samples, found: FittedKernels, index: int, blocks: list[Array]
) -> tuple[Array, Array]:
    y = data.y[:, found.groups[index]]
    whole = condition_gp(found.kernels[index], data.x, y, found.spreads[index])
    inverse = inverse_lower(whole.chol)
    residual = np.empty(y.shape)
    variance = np.empty(len(y))
    for rows in blocks:
        inner = np.linalg.inv(inverse[:, rows].T @ inverse[:, rows])
        residual[rows] = inner @ whole.alpha[rows]
        variance[rows] = np.diag(inner)
    return residual, variance


def _hold_out_sparse(
    data: Samples, found: FittedKernels, index: int, blocks: list[Array]
) -> tuple[Array, Array]:
    base = inducing_bases(data, found)[index]
    return inducing.sparse_held_out_residuals(
        base, data.x, data.y[:, found.groups[index]], found.spreads[index], blocks
    )

"""The selected inverse of a block-tridiagonal matrix, in linear time, forward substitution,
covariances of many small linear maps, and mixtures of normal distributions.
"""

import numpy as np

from .types import Array


def selected_inverse(diagonal: Array, upper: Array) -> tuple[Array, Array]:
    """Diagonal (K,p,p) and upper (K-1,p,p) blocks of the
    inverse, by cyclic reduction: O(K), log K rounds.
    """
    count = len(diagonal)
    if count == 1:
        return np.linalg.inv(diagonal), np.zeros((0, *diagonal.shape[1:]))
    odd = np.linalg.inv(diagonal[1::2])
    before = upper[0::2]
    after = upper[1::2]
    left = np.matmul(before, odd)
    right = np.matmul(odd[: len(after)], after)
    even = diagonal[0::2].copy()
    even[: len(left)] -= np.matmul(left, before.transpose(0, 2, 1))
    even[1 : 1 + len(after)] -= np.matmul(after.transpose(0, 2, 1), right)
    joined = -np.matmul(left[: len(after)], after)
    kept, between = selected_inverse(even, joined)
    return _restore_eliminated_blocks(kept, between, odd, left, right, count)


def _restore_eliminated_blocks(
    kept: Array, between: Array, odd: Array, left: Array, right: Array, count: int
) -> tuple[Array, Array]:
    """Put back the eliminated blocks: Σ_oe = −D⁻¹ B Σ_ee, Σ_oo = D⁻¹ − Σ_oe Bᵀ D⁻¹."""
    inner = len(right)
    order = kept.shape[1]
    diagonal = np.empty((count, order, order))
    upper = np.empty((count - 1, order, order))
    diagonal[0::2] = kept
    before = -np.matmul(kept[: len(left)], left)
    before[:inner] -= np.matmul(between[:inner], right.transpose(0, 2, 1))
    after = -np.matmul(right, kept[1 : 1 + inner])
    after -= np.matmul(left[:inner].transpose(0, 2, 1), between[:inner])
    upper[0::2] = before
    upper[1::2] = after
    diagonal[1::2] = odd - np.matmul(before.transpose(0, 2, 1), left)
    diagonal[1 : 2 * inner : 2] -= np.matmul(after, right.transpose(0, 2, 1))
    return diagonal, upper


SMALL_ROWS = 64
"""Rows of a triangular matrix that LAPACK's general
solver may take; from 20 to 100 cost the same.
"""


def forward_substituted(lower: Array, right: Array) -> Array:
    """L⁻¹ B (N,R) for a lower triangular L (N,N) and B (N,R),
    by halves: NumPy alone has a solver for full matrices.
    """
    half = len(lower) // 2
    if len(lower) <= SMALL_ROWS:
        return np.linalg.solve(lower, right)
    above = forward_substituted(lower[:half, :half], right[:half])
    below = forward_substituted(lower[half:, half:], right[half:] - lower[half:, :half] @ above)
    return np.concatenate([above, below])


def project_covariance(jac: Array, cov: Array) -> Array:
    """J P Jᵀ (F,D,D) of jac (F,D,M) and cov (F,M,M); with
    frames last, products of small matrices are fast.
    """
    jac, cov = (np.ascontiguousarray(np.moveaxis(part, 0, -1)) for part in (jac, cov))
    found = np.einsum("dkf,ekf->fde", np.einsum("dmf,mkf->dkf", jac, cov), jac)
    return np.ascontiguousarray(found)


def mix_normals(shares: Array, means: Array, covs: Array) -> tuple[Array, Array]:
    """Mean (…,M) and covariance (…,M,M) of mixtures of K normal
    distributions: shares (…,K) of sum 1, means (…,K,M), covs (…,K,M,M).
    """
    mean = (shares[..., None, :] @ means)[..., 0, :]
    away = means - mean[..., None, :]
    spread = covs + away[..., :, None] * away[..., None, :]
    return mean, (shares[..., None, None] * spread).sum(axis=-3)

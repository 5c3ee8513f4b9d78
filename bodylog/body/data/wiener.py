"""Integrated white noise on time nodes: precision, solution and selected inverse in linear time."""

from math import factorial

import numpy as np

from ...types import Array


def covariance(order: int, gap: Array) -> Array:
    """Covariance (K,p,p) of (angle, rate, …) after the gaps for unit white noise in the p-th derivative."""
    back = np.arange(order - 1, -1, -1)
    scale = np.array([factorial(int(b)) for b in back], float)
    power = back[:, None] + back + 1.0
    return np.asarray(gap[:, None, None] ** power / (power * scale[:, None] * scale))


def transition(order: int, gap: Array) -> Array:
    """Transition (K,p,p) of (angle, rate, …) over the gaps."""
    lag = np.arange(order)[None, :] - np.arange(order)[:, None]
    coefficient = np.array([[1.0 / factorial(int(k)) if k >= 0 else 0.0 for k in row] for row in lag])
    return np.asarray(coefficient * gap[:, None, None] ** np.maximum(lag, 0))


def precision(order: int, gap: Array) -> tuple[Array, Array]:
    """Precision of (angle, rate, …) on nodes with gaps (K-1,), unit density, diffuse start: diagonal (K,p,p), upper
    (K-1,p,p).
    """
    step = transition(order, gap)
    grow = gap[:, None] ** (order - np.arange(order) - 0.5)
    unit = np.linalg.inv(covariance(order, np.ones(1))[0])
    inverse = unit / (grow[:, :, None] * grow[:, None, :])
    diagonal = np.zeros((len(gap) + 1, order, order))
    diagonal[1:] += inverse
    leant = np.matmul(step.transpose(0, 2, 1), inverse)
    diagonal[:-1] += np.matmul(leant, step)
    return diagonal, -leant


def log_determinant(order: int, gap: Array) -> float:
    """ln|precision| of all nodes but the first, unit density."""
    constant = np.linalg.slogdet(covariance(order, np.ones(1))[0])[1]
    return float(-len(gap) * constant - order**2 * np.log(gap).sum())


def banded(diagonal: Array, upper: Array) -> Array:
    """Upper band storage (2p, K p) of the block-tridiagonal matrix, for LAPACK's pb routines."""
    count, order, _ = diagonal.shape
    band = np.zeros((2 * order, count * order))
    for i in range(order):
        for j in range(order):
            if j >= i:
                band[2 * order - 1 - (j - i), j::order] = diagonal[:, i, j]
            band[order - 1 - (j - i), order + j :: order] = upper[:, i, j]
    return band


def solve(band: Array, right: Array) -> tuple[float, Array]:
    """ln|A| and A⁻¹ right (n,k) of a banded positive definite A."""
    from scipy.linalg.lapack import dpbtrf, dpbtrs

    factor, failed = dpbtrf(band, lower=0)
    if failed:
        raise np.linalg.LinAlgError("the motion prior is too stiff for these times")
    solved, _ = dpbtrs(factor, right, lower=0)
    return 2.0 * float(np.log(factor[-1]).sum()), np.asarray(solved)


def selected_inverse(diagonal: Array, upper: Array) -> tuple[Array, Array]:
    """Diagonal (K,p,p) and upper (K-1,p,p) blocks of the inverse, by cyclic reduction: O(K), log K rounds."""
    count = len(diagonal)
    if count == 1:
        return np.linalg.inv(diagonal), np.zeros((0, *diagonal.shape[1:]))
    odd = np.linalg.inv(diagonal[1::2])
    before, after = upper[0::2], upper[1::2]
    left = np.matmul(before, odd)
    right = np.matmul(odd[: len(after)], after)
    even = diagonal[0::2].copy()
    even[: len(left)] -= np.matmul(left, before.transpose(0, 2, 1))
    even[1 : 1 + len(after)] -= np.matmul(after.transpose(0, 2, 1), right)
    joined = -np.matmul(left[: len(after)], after)
    kept, between = selected_inverse(even, joined)
    return _restore(kept, between, odd, left, right, count)


def _restore(kept: Array, between: Array, odd: Array, left: Array, right: Array, count: int) -> tuple[Array, Array]:
    """Put the eliminated blocks back: Σ_oe = −D⁻¹ B Σ_ee, Σ_oo = D⁻¹ − Σ_oe Bᵀ D⁻¹."""
    inner, order = len(right), kept.shape[1]
    diagonal, upper = np.empty((count, order, order)), np.empty((count - 1, order, order))
    diagonal[0::2] = kept
    before = -np.matmul(kept[: len(left)], left)
    before[:inner] -= np.matmul(between[:inner], right.transpose(0, 2, 1))
    after = -np.matmul(right, kept[1 : 1 + inner])
    after -= np.matmul(left[:inner].transpose(0, 2, 1), between[:inner])
    upper[0::2], upper[1::2] = before, after
    diagonal[1::2] = odd - np.matmul(before.transpose(0, 2, 1), left)
    diagonal[1 : 2 * inner : 2] -= np.matmul(after, right.transpose(0, 2, 1))
    return diagonal, upper

"""Integrated white noise on time nodes: its precision, and solutions in linear time."""

from math import factorial

import numpy as np

from .types import Array


def motion_covariance(order: int, gap: Array) -> Array:
    """Covariance (K,p,p) of (angle, rate, …) after the
    gaps for unit white noise in the p-th derivative.
    """
    back = np.arange(order - 1, -1, -1)
    scale = np.array([factorial(int(b)) for b in back], float)
    power = back[:, None] + back + 1.0
    return np.asarray(gap[:, None, None] ** power / (power * scale[:, None] * scale))


def motion_transition(order: int, gap: Array) -> Array:
    """Transition (K,p,p) of (angle, rate, …) over the gaps."""
    lag = np.arange(order)[None, :] - np.arange(order)[:, None]
    coefficient = np.array(
        [[1.0 / factorial(int(k)) if k >= 0 else 0.0 for k in row] for row in lag]
    )
    return np.asarray(coefficient * gap[:, None, None] ** np.maximum(lag, 0))


def motion_precision(order: int, gap: Array) -> tuple[Array, Array]:
    """Precision of (angle, rate, …) on nodes with gaps
    (K-1,), unit density: diagonal (K,p,p), upper (K-1,p,p).
    """
    step = motion_transition(order, gap)
    grow = gap[:, None] ** (order - np.arange(order) - 0.5)
    unit = np.linalg.inv(motion_covariance(order, np.ones(1))[0])
    inverse = unit / (grow[:, :, None] * grow[:, None, :])
    diagonal = np.zeros((len(gap) + 1, order, order))
    diagonal[1:] += inverse
    leant = np.matmul(step.transpose(0, 2, 1), inverse)
    diagonal[:-1] += np.matmul(leant, step)
    return diagonal, -leant


def motion_log_determinant(order: int, gap: Array) -> float:
    """ln|precision| of all nodes but the first, unit density."""
    constant = np.linalg.slogdet(motion_covariance(order, np.ones(1))[0])[1]
    return float(-len(gap) * constant - order**2 * np.log(gap).sum())


def band_storage(diagonal: Array, upper: Array) -> Array:
    """Upper band storage (2p, K p) of the block-tridiagonal matrix, for LAPACK's pb routines."""
    count, order, _ = diagonal.shape
    band = np.zeros((2 * order, count * order))
    for i in range(order):
        for j in range(order):
            if j >= i:
                band[2 * order - 1 - (j - i), j::order] = diagonal[:, i, j]
            band[order - 1 - (j - i), order + j :: order] = upper[:, i, j]
    return band


def solve_banded_system(band: Array, right: Array) -> tuple[float, Array]:
    """ln|A| and A⁻¹ right (n,k) of a banded positive definite A."""
    from scipy.linalg.lapack import dpbtrf, dpbtrs

    factor, failed = dpbtrf(band, lower=0)
    if failed:
        raise np.linalg.LinAlgError("the motion prior is too stiff for these times")
    solved, _ = dpbtrs(factor, right, lower=0)
    return 2.0 * float(np.log(factor[-1]).sum()), np.asarray(solved)

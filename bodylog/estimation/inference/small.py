"""Many small matrices at once, (n, m, …), stacked along the last axes: numpy's own stacks are slow below 10 rows."""

import numpy as np

from ...types import Array


def outer(a: Array, b: Array) -> Array:
    """a bᵀ (n,m,…) of vectors (n,…) and (m,…)."""
    return np.asarray(a[:, None] * b[None])


def product(a: Array, b: Array) -> Array:
    """a b (n,k,…) of matrices (n,m,…) and (m,k,…)."""
    found = outer(a[:, 0], b[0])
    for inner in range(1, len(b)):
        found += outer(a[:, inner], b[inner])
    return found


def transposed_product(a: Array, b: Array) -> Array:
    """aᵀ b (n,k,…) of matrices (m,n,…) and (m,k,…)."""
    return product(a.swapaxes(0, 1), b)


def spd_inverse(a: Array) -> Array:
    """Inverse (n,n,…) of symmetric positive definite matrices, by the sweep operator (Beaton 1964)."""
    a = a.copy()
    for row in range(len(a)):
        pivot, column = a[row, row].copy(), a[:, row].copy()
        if not (pivot > 0.0).all():
            raise np.linalg.LinAlgError("a matrix is not positive definite")
        scaled = column / pivot
        a -= outer(scaled, column)
        a[row] = a[:, row] = scaled
        a[row, row] = -1.0 / pivot
    return np.asarray(-a)

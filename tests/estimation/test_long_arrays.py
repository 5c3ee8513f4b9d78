"""Masks of rows, and triangular solutions, agree with NumPy's."""

import numpy as np
import pytest

from bodylog.estimation.measurements import long_arrays
from bodylog.linear_algebra import forward_substituted


@pytest.mark.parametrize("columns", [0, 1, 2, 7])
def test_masks_of_rows_are_numpys(columns):
    values = np.random.default_rng(columns).normal(size=(50, columns))
    values[values > 1.0] = np.nan
    known = np.isfinite(values)
    np.testing.assert_array_equal(long_arrays.find_finite_rows(values), known.all(axis=1))
    some = long_arrays.find_finite_rows(values)
    np.testing.assert_array_equal(values[long_arrays.index_true_rows(some)], values[some])


@pytest.mark.parametrize("size", [1, 64, 65, 200])
def test_forward_substitution_is_the_full_solution(size):
    rng = np.random.default_rng(size)
    lower, right = np.tril(rng.normal(size=(size, size))) / size + 2.0 * np.eye(size), rng.normal(size=(size, 3))
    np.testing.assert_allclose(forward_substituted(lower, right), np.linalg.solve(lower, right), rtol=1e-12, atol=1e-13)

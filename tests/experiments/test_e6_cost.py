"""The exponent of a cost, and counted multiplications."""

import numpy as np

from bodylog.experiments.e6_cost import counted, exponent


def test_exponent_of_a_power():
    assert np.isclose(exponent({n: 3e-9 * n**2.5 for n in (10, 40, 160)}), 2.5)


def test_dense_slopes_cost_the_product_and_sparse_ones_the_sum():
    assert counted(7, 5, 5) == 35 and counted(7, 5, 1) == 7

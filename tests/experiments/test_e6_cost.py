"""The exponent of a cost."""

import numpy as np

from bodylog.experiments.e6_cost import exponent


def test_exponent_of_a_power():
    assert np.isclose(exponent({n: 3e-9 * n**2.5 for n in (10, 40, 160)}), 2.5)

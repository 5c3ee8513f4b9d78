"""The exponent of a cost, and counted multiplications."""

import numpy as np
import pytest

from bodylog.experiments import e6_cost
from bodylog.experiments.records import ExperimentReadings


def test_exponent_of_a_power():
    assert e6_cost.fit_exponent({n: 7 * n**2 for n in (10, 40, 160)}) == pytest.approx(2.0)


def test_dense_slopes_cost_the_product_and_sparse_ones_the_sum():
    assert e6_cost.count_step(7, 5, 5) == 35 and e6_cost.count_step(7, 5, 1) == 7


def test_counted_cholesky_is_the_factor_and_costs_a_sixth_of_the_cube():
    draw = np.random.default_rng(0).standard_normal((12, 12))
    matrix = draw @ draw.T + np.eye(12)
    root, count = e6_cost.factor_by_cholesky(matrix.tolist())
    assert np.allclose(root, np.linalg.cholesky(matrix)) and count == 12 * 13 * 14 // 6


def test_step_costs_n_times_m_where_slopes_are_dense():
    trial = e6_cost.EXPERIMENT.run(None, 0, ExperimentReadings(({},)))
    verdicts = {claim.id: claim.verdict for claim in e6_cost.EXPERIMENT.claims([trial], ExperimentReadings(({},)))}
    assert verdicts == {"E6.1": "kept", "E6.2": "kept", "E6.3": "depends on how many joints a sense depends on"}

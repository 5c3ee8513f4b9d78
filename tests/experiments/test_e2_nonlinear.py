"""Squared encoders as a forward model."""

import numpy as np

from bodylog.experiments.e2_nonlinear import SquaredEncoders, time_to_converge


def test_jacobian_of_squares_agrees_with_differences():
    model, x = SquaredEncoders(("a", "b")), np.array([[0.3, -0.7]])
    mean, jac, var = model.predict(x)
    for j, step in enumerate(1e-6 * np.eye(2)):
        slope = (model.predict(x + step)[0] - model.predict(x - step)[0]) / 2e-6
        assert np.allclose(jac[0, :, j], slope[0])
    assert np.allclose(mean, x**2) and not var.any()


def test_convergence_is_the_last_time_a_belief_was_far():
    t, true = np.arange(5.0), np.ones((5, 1))
    assert time_to_converge(t, np.array([[2.0], [1.0], [2.0], [1.0], [-1.0]]), true) == 3.0
    assert time_to_converge(t, 2.0 * true, true) == np.inf
    assert np.isnan(time_to_converge(t, np.nan * true, true))
    assert time_to_converge(t, -true, true) == 0.0

"""Squared encoders as a forward model."""

import numpy as np

from bodylog.experiments.e2_nonlinear import Squared, converged


def test_jacobian_of_squares_agrees_with_differences():
    model, x = Squared(("a", "b")), np.array([[0.3, -0.7]])
    mean, jac, var = model.predict(x)
    for j, step in enumerate(1e-6 * np.eye(2)):
        slope = (model.predict(x + step)[0] - model.predict(x - step)[0]) / 2e-6
        assert np.allclose(jac[0, :, j], slope[0])
    assert np.allclose(mean, x**2) and not var.any()


def test_convergence_is_the_last_time_a_belief_was_far():
    t, true = np.arange(5.0), np.ones((5, 1))
    assert converged(t, np.array([[2.0], [1.0], [2.0], [1.0], [-1.0]]), true) == 3.0
    assert converged(t, 2.0 * true, true) == np.inf
    assert np.isnan(converged(t, np.nan * true, true))
    assert converged(t, -true, true) == 0.0

"""Errors of encoders that last through an exploration, drawn and found again by their likelihood."""

import numpy as np
import pytest

from bodylog.delays import lasting_likelihood
from bodylog.delays.lasting_likelihood import (
    TrackResiduals,
    lasting_covariance,
    measure_lasting_errors,
)

STD = np.array([2e-3, 1e-3, 1.5e-3])
SECONDS = 1.0


def drawn(std, seed=1, count=100, seconds=SECONDS):
    """Residuals of a track seen ten times a second, with slopes that turn, and noise of 0.3 px."""
    rng = np.random.default_rng(seed)
    t = 0.1 * np.arange(count)
    phase = rng.uniform(0.0, 6.0, (2, 3))
    slopes = 400.0 * np.concatenate([np.sin(0.3 * t[:, None] + phase[d]) for d in range(2)])
    both = np.tile(t, 2)
    noise = 0.09 * np.eye(2 * count)
    prior = np.kron(np.eye(2), 0.04 * np.exp(-0.5 * np.square((t[:, None] - t) / 5.0)))
    cov = prior + noise + lasting_covariance(slopes, both, std, seconds)
    residual = np.linalg.cholesky(cov + 1e-9 * np.eye(2 * count)) @ rng.normal(size=2 * count)
    return TrackResiduals(residual, prior, noise, slopes, both)


def test_errors_that_last_are_found_and_white_ones_are_not():
    stds, seconds, nats = measure_lasting_errors([drawn(STD, seed) for seed in range(11, 17)])
    assert np.sqrt(np.mean(stds**2)) == pytest.approx(np.sqrt(np.mean(STD**2)), rel=0.3)
    assert seconds == pytest.approx(SECONDS, rel=0.6)
    assert nats > 12.0
    for seed in range(3, 7):
        assert measure_lasting_errors([drawn(0.0 * STD, seed)]) is None
    assert measure_lasting_errors([]) is None


def test_errors_that_last_two_steps_between_residuals_are_found():
    for seed in range(21, 25):
        found = measure_lasting_errors([drawn(STD, seed, 200, 0.2)])
        assert found is not None
        assert found[1] == pytest.approx(0.2, rel=0.5)


def test_the_gradient_is_that_of_the_likelihood():
    tracks = [drawn(STD, count=40)]
    p = np.log([1.2, 1e-3, 2e-3, 1e-3, 0.7])
    slope = lasting_likelihood._cost(p, tracks)[1]
    steps = 1e-5 * np.eye(len(p))
    ends = [[lasting_likelihood._cost(p + way * step, tracks)[0] for way in (1, -1)] for step in steps]
    np.testing.assert_allclose(slope, [(up - down) / 2e-5 for up, down in ends], rtol=1e-4, atol=1e-4)

import numpy as np
import pytest

from bodylog.body.gp.cross_validation import held_out_residuals
from bodylog.body.gp.fit import FittedKernels, Samples
from bodylog.body.gp.marginal_likelihood import Hyper, Spread, independent_noise
from bodylog.body.gp.model import se_kernel


@pytest.mark.parametrize("count", [60, 600])
def test_residuals_are_those_of_a_fit_without_the_block(count: int) -> None:
    draw = np.random.default_rng(count)
    x = draw.uniform(-1, 1, (count, 2))
    y = np.column_stack([10 * np.sin(x[:, 0]), 5 * x[:, 1]]) + draw.normal(0, 0.2, (count, 2))
    kernel, block = Hyper(np.array([0.9, 1.1]), 50.0, 0.04), np.arange(count) * 6 // count
    found = FittedKernels((slice(0, 2),), (kernel,), (independent_noise(np.zeros(count)),))
    residual, variance = held_out_residuals(Samples(x, y, np.zeros(y.shape)), found, block)
    rows, kept = block == 2, block != 2
    gram = se_kernel(x / kernel.scales, x / kernel.scales, kernel.amplitude) + kernel.noise * np.eye(count)
    inner = np.linalg.inv(gram[np.ix_(kept, kept)])
    # ordinary kriging with the constant mean of the whole (exact) or of the rest (sparse): nearly equal
    mean = inner.sum(axis=0) @ y[kept] / inner.sum()
    expected = y[rows] - mean - gram[np.ix_(rows, kept)] @ inner @ (y[kept] - mean)
    spread = np.diag(gram[np.ix_(rows, rows)] - gram[np.ix_(rows, kept)] @ inner @ gram[np.ix_(kept, rows)])
    assert np.abs(residual[rows] - expected).max() < 0.05
    assert np.allclose(variance[rows, 0], spread, rtol=0.02)


def test_coupled_noise_is_not_fitted_as_signal() -> None:
    draw = np.random.default_rng(1)
    x = np.linspace(-1, 1, 200)[:, None]
    lag = np.abs(np.arange(200)[:, None] - np.arange(200))
    noise = 0.25 * np.where(lag < 6, 0.8**lag * (1 - lag / 6), 0.0)
    y = np.sin(2 * x) + (np.linalg.cholesky(noise + 1e-9 * np.eye(200)) @ draw.normal(size=200))[:, None]
    i, j = np.nonzero(np.tril(noise, -1))
    kernel, block = Hyper(np.ones(1), 1.0, 1e-6), np.arange(200) // 20
    for spread, low, high in ((Spread(np.diag(noise), i, j, noise[i, j]), 0.6, 1.5),):
        residual, variance = held_out_residuals(Samples(x, y, 0 * y), FittedKernels((slice(0, 1),), (kernel,), (spread,)), block)
        assert low < np.mean(residual**2 / variance) < high

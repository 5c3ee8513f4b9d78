import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bodylog.body.gp.marginal_likelihood import (
    FLAT,
    ROTATION,
    Hyper,
    Prior,
    Spread,
    cholesky_with_jitter,
    draw_kernel_starts,
    hyper_from_theta,
    independent_noise,
    log_marginal_likelihood,
    maximise_evidence,
)
from bodylog.body.gp.model import se_kernel
from bodylog.types import Array


def _problem(seed: int, count: int, inputs: int, outputs: int) -> tuple[Array, Array, Array, Spread]:
    draw = np.random.default_rng(seed)
    x, y = draw.uniform(-1, 1, (count, inputs)), draw.normal(0, 1, (count, outputs))
    theta = np.concatenate([[draw.normal()], draw.normal(0, 0.5, inputs), [draw.normal(-2, 0.5)]])
    i = np.arange(1, count)
    return theta, x, y, Spread(draw.uniform(0.1, 0.3, count), i, i - 1, draw.uniform(-0.04, 0.04, count - 1))


def _dense(theta: Array, x: Array, y: Array, spread: Spread) -> float:
    kernel = hyper_from_theta(theta)
    matrix = se_kernel(x / kernel.scales, x / kernel.scales, kernel.amplitude)
    matrix += np.diag(spread.diagonal + kernel.noise + 1e-10 * kernel.amplitude)
    matrix[spread.i, spread.j] += spread.value
    matrix[spread.j, spread.i] += spread.value
    ones = np.linalg.solve(matrix, np.ones(len(y)))
    centred = y - ones @ y / ones.sum()
    fit = (centred * np.linalg.solve(matrix, centred)).sum()
    return float(-0.5 * (fit + y.shape[1] * (np.linalg.slogdet(matrix)[1] + len(y) * np.log(2 * np.pi))))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), inputs=st.integers(1, 6), outputs=st.integers(1, 3))
def test_evidence_and_gradient_are_those_of_the_dense_formula(seed: int, inputs: int, outputs: int) -> None:
    theta, x, y, spread = _problem(seed, 25, inputs, outputs)
    value, gradient = log_marginal_likelihood(theta, x, y, spread)
    assert value == pytest.approx(_dense(theta, x, y, spread), rel=1e-9)
    h = 1e-4
    for k, step in enumerate(h * np.eye(len(theta))):
        near = _dense(theta + step, x, y, spread) - _dense(theta - step, x, y, spread)
        far = _dense(theta + 2 * step, x, y, spread) - _dense(theta - 2 * step, x, y, spread)
        assert gradient[k] == pytest.approx((8 * near - far) / (12 * h), rel=1e-6, abs=1e-6 * np.abs(gradient).max())


@pytest.mark.parametrize("seed", range(3))
def test_maximise_finds_the_kernel_that_drew_the_data(seed: int) -> None:
    draw = np.random.default_rng(seed)
    x = draw.uniform(-3, 3, (250, 2))
    truth = Hyper(np.array([0.8, 2.0]), 1.0, 0.01)
    gram = se_kernel(x / truth.scales, x / truth.scales, truth.amplitude) + 0.01 * np.eye(250)
    y = (np.linalg.cholesky(gram) @ draw.normal(size=250))[:, None]
    found = maximise_evidence(x, y, independent_noise(np.zeros(250)), FLAT, draw_kernel_starts(x, 0, 3))
    assert np.allclose(np.log(found.scales / truth.scales), 0, atol=0.3)
    assert found.noise == pytest.approx(truth.noise, rel=0.4)


def test_maximise_returns_the_prior_without_information() -> None:
    draw = np.random.default_rng(0)
    x = np.column_stack([draw.uniform(-1, 1, 60), draw.normal(0, 1e-3, 60)])
    y = np.sin(2 * x[:, :1]) + draw.normal(0, 0.05, (60, 1))
    found = maximise_evidence(x, y, independent_noise(np.zeros(60)), ROTATION, draw_kernel_starts(x, 0, 2))
    assert found.scales[1] == pytest.approx(1.0, rel=0.05)


def test_jitter_saves_a_singular_matrix_and_zeros_stay_above_the_diagonal() -> None:
    gram = np.ones((5, 5))
    chol = cholesky_with_jitter(gram, independent_noise(np.zeros(5)), 0.0)
    assert np.allclose(chol @ chol.T, gram, atol=1e-6)
    assert np.array_equal(chol, np.tril(chol))
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        cholesky_with_jitter(np.diag([1.0, -5.0]), independent_noise(np.zeros(2)), 0.0)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("count", [15, 46, 150])
@pytest.mark.parametrize("prior", [FLAT, ROTATION])
def test_one_descent_equals_the_best_of_many(seed: int, count: int, prior: Prior, camera) -> None:
    draw = np.random.default_rng(seed)
    x = draw.uniform([-0.8, -0.4, 0.1], [0.8, 0.9, 1.2], (count, 3))
    y = (camera(x) + draw.normal(0, 0.3, (count, 2))) / 40.0
    nothing, guesses = independent_noise(np.zeros(count)), draw_kernel_starts(x, 0, 12)

    def loss(kernel: Hyper) -> float:
        away = (np.log(kernel.scales) - np.log(prior.scales)) / prior.width
        return 0.5 * float(away @ away) - log_marginal_likelihood(kernel.theta, x, y, nothing)[0]

    best = min(loss(maximise_evidence(x, y, nothing, prior, guess[None])) for guess in guesses[:6])
    assert loss(maximise_evidence(x, y, nothing, prior, guesses)) < best + 0.01

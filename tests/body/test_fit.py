import tracemalloc

import numpy as np
import pytest

from bodylog.body.gp.fit import (
    Coupling,
    Samples,
    assemble_exact_gp,
    build_gp,
    fit_kernels,
    fit_kernels_and_noise,
    propagate_input_noise,
    samples_without_noise,
    train_gp,
)
from bodylog.body.gp.marginal_likelihood import (
    FLAT,
    ROTATION,
    independent_noise,
    log_marginal_likelihood,
)
from bodylog.types import Array


def _arm(seed: int, count: int, angle: float, camera) -> tuple[Array, Samples]:
    """True angles and samples whose angles carry noise (rad)."""
    draw = np.random.default_rng(seed)
    q = draw.uniform([-0.8, -0.4, 0.1], [0.8, 0.9, 1.2], (count, 3))
    y = camera(q) + draw.normal(0, 0.3, (count, 2))
    x = q + draw.normal(0, angle, q.shape)
    return q, Samples(x, y, np.zeros(y.shape), np.full(x.shape, max(angle, 1e-9) ** 2))


def test_input_noise_is_separated_from_pixel_noise(camera) -> None:
    informed, blinded, squares = [], [], []
    for seed in range(6):
        _, data = _arm(seed, 250, 0.01, camera)
        gp = assemble_exact_gp(data, fit_kernels_and_noise(data, ROTATION, True, 0), ("u", "v"), "px")
        blind = train_gp(samples_without_noise(data.x, data.y), ("u", "v"), "px")
        assert np.sqrt(gp.noise).max() < 0.9 and np.sqrt(blind.noise).min() > 1.2
        fresh, _ = _arm(seed + 100, 400, 0.0, camera)
        (value, _, spread), truth = gp.predict(fresh), camera(fresh)
        squares.append(np.mean((value - truth) ** 2 / spread))
        informed.append(np.mean((value - truth) ** 2))
        blinded.append(np.mean((blind.predict(fresh)[0] - truth) ** 2))
    assert np.mean(informed) < 1.1 * np.mean(blinded)
    assert 0.7 < np.mean(squares) < 1.7


def test_noise_of_a_sample_is_floor_and_slope_times_input_noise(camera) -> None:
    _, data = _arm(0, 60, 0.01, camera)
    coupled = Coupling(np.array([1, 1]), np.array([0, 0]), np.array([0, 2]), np.array([5e-5, 3e-5]))
    data = Samples(data.x, data.y, np.full(data.y.shape, 0.09), data.variance, coupled)
    gp = train_gp(samples_without_noise(data.x, data.y), ("u", "v"), "px")
    slope = gp.predict(data.x)[1]
    (both,) = propagate_input_noise(data, gp, [slice(0, 2)])
    expected = 0.09 + 1e-4 * (slope**2).sum(axis=2)
    assert both.share == pytest.approx(expected.mean(axis=0) / expected.mean())
    assert np.allclose(both.diagonal, (expected / both.share).mean(axis=1))
    joined = (slope[1] * slope[0] * np.array([5e-5, 0, 3e-5])).sum(axis=1) / both.share
    assert (both.i.tolist(), both.j.tolist()) == ([1], [0]) and both.value == pytest.approx(joined.mean())
    each = propagate_input_noise(data, gp, [slice(0, 1), slice(1, 2)])
    assert np.allclose(np.column_stack([s.diagonal for s in each]), expected)


def test_shared_and_separate_kernels_agree_on_one_output(camera) -> None:
    _, data = _arm(1, 80, 0.0, camera)
    one = Samples(data.x, data.y[:, :1], data.floor[:, :1])
    gps = [assemble_exact_gp(one, fit_kernels_and_noise(one, FLAT, shared, 0), ("u",), "px") for shared in (True, False)]
    assert np.array_equal(gps[0].weights, gps[1].weights) and np.array_equal(gps[0].scales, gps[1].scales)


def test_separate_kernels_have_each_its_own_greatest_evidence(camera) -> None:
    _, data = _arm(2, 80, 0.0, camera)
    data = samples_without_noise(data.x, data.y)
    found = fit_kernels_and_noise(data, FLAT, False, 0)
    assert len(found.kernels) == 2
    for d, kernel in enumerate(found.kernels):
        gradient = log_marginal_likelihood(kernel.theta, data.x, data.y[:, d : d + 1], independent_noise(np.zeros(80)))[1]
        assert np.abs(gradient[:-1]).max() < 0.2
    gp = build_gp(data, found, ("u", "v"), "px")
    assert gp.scales.shape == (2, 3) and gp.factor.shape == (2, 80, 80)


def test_fit_is_deterministic_for_a_seed(camera) -> None:
    _, data = _arm(3, 300, 0.003, camera)
    one, again = (fit_kernels(data, ROTATION, True, 7) for _ in range(2))
    assert one.kernels[0].theta.tolist() == again.kernels[0].theta.tolist()
    other = fit_kernels(data, ROTATION, True, 8)
    assert np.allclose(one.kernels[0].theta[:-1], other.kernels[0].theta[:-1], atol=0.02)


@pytest.mark.parametrize("count", [400, 1200])
def test_more_samples_than_are_exact_are_all_used(count: int, camera) -> None:
    _, data = _arm(4, count, 0.0, camera)
    q = np.random.default_rng(9).uniform([-0.8, -0.4, 0.1], [0.8, 0.9, 1.2], (500, 3))
    few = train_gp(samples_without_noise(data.x[:150], data.y[:150]), ("u", "v"), "px")
    many = train_gp(samples_without_noise(data.x, data.y), ("u", "v"), "px", exact=150)
    error = [np.sqrt(np.mean((gp.predict(q)[0] - camera(q)) ** 2)) for gp in (few, many)]
    assert error[1] < 0.7 * error[0]


@pytest.mark.soak
def test_train_fits_100000_samples_in_little_memory(camera) -> None:
    _, data = _arm(5, 100_000, 0.0, camera)
    data = samples_without_noise(data.x, data.y)
    tracemalloc.start()
    found = fit_kernels(data, ROTATION, True, 0)
    gp = build_gp(data, found, ("u", "v"), "px")
    assert tracemalloc.get_traced_memory()[1] < 2e9
    tracemalloc.stop()
    part = data.rows(np.arange(3000))
    few = build_gp(part, fit_kernels(part, ROTATION, True, 0), ("u", "v"), "px", 3000)
    q = np.random.default_rng(9).uniform([-0.8, -0.4, 0.1], [0.8, 0.9, 1.2], (2000, 3))
    many, exact = (np.sqrt(np.mean((m.means(q)[0] - camera(q)) ** 2)) for m in (gp, few))
    assert many < 1.05 * exact


def test_predict_gives_more_variance_with_more_input_noise() -> None:
    far, squares = np.array([40.0, 160.0]), []
    for seed in range(8):
        draw = np.random.default_rng(seed)
        true, fresh = draw.uniform(-0.5, 0.5, (120, 2)), draw.uniform(-0.4, 0.4, (200, 2))

        def seen(x):
            return far * np.column_stack([np.sin(x[:, 0]), np.sin(x[:, 0] + 0.5 * x[:, 1])])

        y = seen(true) + draw.normal(0, 0.02, true.shape)
        data = Samples(
            true + draw.normal(0, 0.003, true.shape), y, np.full(y.shape, 0.02**2), np.full(true.shape, 0.003**2)
        )
        gp = assemble_exact_gp(data, fit_kernels_and_noise(data, ROTATION, True, 0), ("u", "v"), "px")
        assert 3.0 < np.sqrt(gp.share[1] / gp.share[0]) < 6.0
        value, _, spread = gp.predict(fresh)
        squares.append(np.mean((value - seen(fresh)) ** 2 / spread, axis=0))
    assert np.all((np.mean(squares, axis=0) > 0.6) & (np.mean(squares, axis=0) < 1.6))

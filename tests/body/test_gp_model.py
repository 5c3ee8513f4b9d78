import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bodylog.body.gp.fit import (
    FittedKernels,
    Samples,
    assemble_exact_gp,
    samples_without_noise,
    train_gp,
)
from bodylog.body.gp.marginal_likelihood import Hyper, independent_noise
from bodylog.body.gp.model import GP, MISFIT, NEGLIGIBLE, drop_negligible_rows, se_kernel


def _random(seed: int, count: int, inputs: int, outputs: int, shared: bool) -> GP:
    draw = np.random.default_rng(seed)
    x, y = draw.uniform(-2, 2, (count, inputs)), draw.normal(0, 30, (count, outputs))
    groups = (slice(0, outputs),) if shared else tuple(slice(d, d + 1) for d in range(outputs))
    kernels = tuple(
        Hyper(np.exp(draw.normal(0, 0.5, inputs)), float(np.exp(draw.normal(4, 1))), float(np.exp(draw.normal(-1, 1))))
        for _ in groups
    )
    found = FittedKernels(groups, kernels, tuple(independent_noise(draw.uniform(0, 1, count)) for _ in groups))
    return assemble_exact_gp(samples_without_noise(x, y), found, tuple(f"o{d}" for d in range(outputs)), "px")


_sizes = {"seed": st.integers(0, 10_000), "inputs": st.integers(1, 7), "outputs": st.integers(1, 3)}


@settings(max_examples=25, deadline=None)
@given(shared=st.booleans(), **_sizes)
def test_jacobian_is_the_derivative_of_the_mean(seed: int, inputs: int, outputs: int, shared: bool) -> None:
    gp = _random(seed, 30, inputs, outputs, shared)
    x = np.random.default_rng(seed).uniform(-2, 2, (5, inputs))
    slope = gp.predict(x)[1]
    h = 1e-4
    for m in range(inputs):
        step = h * np.eye(inputs)[m]
        # five points: the error of the difference is of fourth order
        near, far = gp.means(x + step)[0] - gp.means(x - step)[0], gp.means(x + 2 * step)[0] - gp.means(x - 2 * step)[0]
        assert np.allclose(slope[:, :, m], (8 * near - far) / (12 * h), rtol=1e-6, atol=1e-6 * np.abs(slope).max())


@settings(max_examples=15, deadline=None)
@given(shared=st.booleans(), **_sizes)
def test_one_point_and_many_agree(seed: int, inputs: int, outputs: int, shared: bool) -> None:
    gp = _random(seed, 40, inputs, outputs, shared)
    x = np.random.default_rng(seed + 1).uniform(-3, 3, (6, inputs))
    many = gp.predict(x)
    for row, point in enumerate(x):
        for one, all_of_them in zip(gp.predict_one(point), many, strict=True):
            assert np.allclose(one, all_of_them[row], rtol=1e-9, atol=1e-8 * np.abs(all_of_them).max())


@pytest.mark.parametrize("seed", range(5))
def test_mean_and_variance_are_those_of_the_textbook(seed: int) -> None:
    gp = _random(seed, 25, 3, 1, True)
    kernel = se_kernel(gp.samples / gp.scales[0], gp.samples / gp.scales[0], gp.amplitude[0])
    noisy = kernel + np.diag(gp.spread[:, 0] + gp.noise[0])
    x = np.random.default_rng(seed).uniform(-2, 2, (7, 3))
    cross = se_kernel(x / gp.scales[0], gp.samples / gp.scales[0], gp.amplitude[0])
    value, _, spread = gp.predict(x)
    expected = gp.mean[0] + cross @ np.linalg.solve(noisy, gp.targets[:, 0] - gp.mean[0])
    left = gp.amplitude[0] - np.einsum("ij,ji->i", cross, np.linalg.solve(noisy, cross.T))
    assert np.allclose(value[:, 0], expected, rtol=1e-6)
    assert np.allclose(spread[:, 0], MISFIT * left, rtol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_slope_variance_is_the_curvature_of_the_covariance(seed: int) -> None:
    gp, h = _random(seed, 20, 2, 2, False), 1e-4
    x = np.random.default_rng(seed).uniform(-1, 1, 2)
    for m in range(2):
        step = h * np.eye(2)[m]
        block = gp.covariance(np.array([x + step, x - step]))
        expected = (block[:, 0, 0] + block[:, 1, 1] - 2 * block[:, 0, 1]) / (2 * h) ** 2
        assert np.allclose(gp.slope_variance(x[None])[0, :, m], expected, rtol=1e-3)


@settings(max_examples=20, deadline=None)
@given(shared=st.booleans(), count=st.sampled_from([30, 200]), **_sizes)
def test_shortened_factor_keeps_the_variance(seed: int, count: int, inputs: int, outputs: int, shared: bool) -> None:
    gp = _random(seed, count, inputs, outputs, shared)
    short, draw = drop_negligible_rows(gp), np.random.default_rng(seed)
    x = np.concatenate([gp.samples[:20], draw.uniform(-2, 2, (20, inputs)), draw.uniform(-6, 6, (20, inputs))])
    whole, less = gp.predict(x)[2], short.predict(x)[2]
    # plus the rounding of a difference of two amplitudes
    assert (np.abs(less - whole) <= 1.01 * NEGLIGIBLE * whole + 1e-11 * gp.amplitude.max()).all()
    assert (less >= whole - 1e-11 * gp.amplitude.max()).all()
    assert short.factor.shape[1] <= count


def test_shortened_factor_of_a_smooth_model_is_small() -> None:
    assert drop_negligible_rows(_random(0, 400, 2, 2, True)).factor.shape[1] < 200


def test_covariance_has_the_variance_on_its_diagonal() -> None:
    gp, x = _random(3, 20, 3, 2, False), np.random.default_rng(3).uniform(-1, 1, (9, 3))
    assert np.allclose(np.diagonal(gp.covariance(x), axis1=1, axis2=2).T, gp.predict(x)[2], rtol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_gp_keeps_precision_at_a_large_amplitude(seed: int) -> None:
    """A mean is as exact as its largest terms, however large the amplitude."""
    draw = np.random.default_rng(seed)
    centres, weights = draw.uniform(-1, 1, (60, 3)), draw.normal(0, 1, (2, 60))
    scales, amplitude = draw.uniform(1, 2, (1, 3)), np.array([1e12])
    none = np.zeros((60, 2))
    gp = GP(("u", "v"), "px", centres, scales, amplitude, np.zeros(2), weights, np.zeros((1, 1, 60)), np.zeros(2),
            centres, none, none)  # fmt: skip
    x = draw.uniform(-1, 1, (50, 3))
    long = np.longdouble
    kernel = amplitude * np.exp(-0.5 * (((x[:, None].astype(long) - centres) / scales[0]) ** 2).sum(axis=-1))
    exact, size = kernel @ weights.T.astype(long), kernel @ np.abs(weights.T)
    for found in (gp.predict(x)[0], np.array([gp.predict_one(point)[0] for point in x])):
        assert (np.abs(found - exact) / size).max() < 2 * np.finfo(float).eps


def test_gp_returns_to_the_prior_far_from_samples() -> None:
    gp = _random(1, 20, 3, 2, False)
    value, slope, spread = gp.predict(np.full((2, 3), 1e3))
    assert np.allclose(value, gp.mean) and np.allclose(slope, 0) and np.allclose(spread, MISFIT * gp.amplitude)
    for one, all_of_them in zip(gp.predict_one(np.full(3, 1e3)), (value, slope, spread), strict=True):
        assert np.allclose(one, all_of_them[0])


def test_blocks_equal_single_points() -> None:
    gp = _random(2, 400, 2, 2, True)
    x = np.random.default_rng(0).uniform(-2, 2, (3000, 2))
    value, slope, spread = gp.predict(x)
    for row in (0, 1310, 1311, 2999):
        one = gp.predict_one(x[row])
        assert np.allclose(value[row], one[0]) and np.allclose(slope[row], one[1]) and np.allclose(spread[row], one[2])


@pytest.mark.parametrize("case", ["duplicates", "constant input", "constant output", "one outlier", "quiet"])
def test_awkward_data_still_give_a_finite_model(case: str) -> None:
    draw = np.random.default_rng(0)
    x = draw.uniform(-1, 1, (30, 2))
    y = np.column_stack([100 * np.sin(x[:, 0]), 50 * x[:, 1]])
    if case == "duplicates":
        x, y = np.repeat(x[:10], 3, axis=0), np.repeat(y[:10], 3, axis=0)
    if case == "constant input":
        x[:, 1], y[:, 1] = 0.3, y[:, 0]
    if case == "constant output":
        y[:] = 7.0
    if case == "one outlier":
        y[3] = 1e6
    if case != "quiet":
        y = y + draw.normal(0, 0.1, y.shape)
    data = Samples(x, y, np.zeros(y.shape), np.full(x.shape, 1e-6)) if case == "quiet" else samples_without_noise(x, y)
    gp = train_gp(data, ("u", "v"), "px")
    value, slope, spread = gp.predict(x)
    assert all(np.isfinite(part).all() for part in (value, slope, spread))
    if case != "one outlier":
        assert np.abs(value - y).max() < 1.0


@pytest.mark.parametrize("seed", range(5))
def test_errors_decorrelate_over_reach(seed: int) -> None:
    draw = np.random.default_rng(seed)
    x = draw.uniform(-1, 1, (80, 3))
    y = np.stack([np.sin(x.sum(axis=1)), np.cos(2 * x[:, 0]), np.sin(x[:, 1])], axis=1)
    gp = train_gp(samples_without_noise(x, y), ("x", "y", "z"), "mm", seed)
    # angles of each joint from other samples
    at_others = np.column_stack([x[:, 0], np.roll(x[:, 1], 26), np.roll(x[:, 2], 52)])
    for joint, reach in enumerate(gp.reach):
        step = 0.1 * reach * np.eye(3)[joint]
        both = [gp.covariance(np.stack([at, at + step]))[0] for at in at_others]
        correlation = np.sum([c[0, 1] for c in both]) / np.sum([np.sqrt(c[0, 0] * c[1, 1]) for c in both])
        assert correlation == pytest.approx(np.exp(-0.5 * 0.1**2), abs=0.002)

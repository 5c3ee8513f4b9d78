import numpy as np
import pytest

from bodylog.body.gp import inducing
from bodylog.body.gp.fit import (
    FittedKernels,
    Samples,
    assemble_exact_gp,
    assemble_sparse_gp,
    build_gp,
    samples_without_noise,
)
from bodylog.body.gp.marginal_likelihood import Hyper, Spread, condition_gp, independent_noise
from bodylog.types import Array

_KERNEL = Hyper(np.array([0.8, 1.2]), 400.0, 0.05)


def _data(seed: int, count: int) -> tuple[Array, Array, Spread]:
    draw = np.random.default_rng(seed)
    x = draw.uniform(-1, 1, (count, 2))
    y = np.column_stack([20 * np.sin(2 * x[:, 0]), 15 * np.cos(x[:, 0] + x[:, 1])]) + draw.normal(
        0, 0.3, (count, 2)
    )
    i = np.arange(1, count)
    return x, y, Spread(np.full(count, 0.05), i, i - 1, np.full(count - 1, 0.02))


@pytest.mark.parametrize("seed", range(3))
def test_enough_inducing_points_give_the_exact_posterior(seed: int) -> None:
    x, y, spread = _data(seed, 300)
    found = FittedKernels((slice(0, 2),), (_KERNEL,), (spread,))
    exact, thin = (
        make(samples_without_noise(x, y), found, ("u", "v"), "px")
        for make in (assemble_exact_gp, assemble_sparse_gp)
    )
    at = np.random.default_rng(9).uniform(-1, 1, (50, 2))
    assert len(thin.centres) < 150
    value, slope, spread = exact.predict(at)
    near = thin.predict(at)
    assert np.abs(value - near[0]).max() < 0.03 * np.sqrt(spread.min())
    assert np.allclose(spread, near[2], rtol=0.005)
    assert np.abs(slope - near[1]).max() < 0.2 * np.sqrt(exact.slope_variance(at).max())


@pytest.mark.parametrize("seed", range(3))
def test_bound_is_below_the_evidence_and_meets_it(seed: int) -> None:
    x, y, spread = _data(seed, 120)
    exact = condition_gp(_KERNEL, x, y, spread).evidence
    bounds = []
    for count in (5, 15, 60, 120):
        base = inducing.build_basis(_KERNEL, x[:count])
        bounds.append(
            inducing.sparse_posterior(base, inducing.sufficient_sums(base, x, y, spread)).bound
        )
    assert bounds == sorted(bounds) and bounds[-1] <= exact + 1e-3
    assert bounds[-1] == pytest.approx(exact, abs=0.1)


def test_held_out_is_a_fit_without_the_block() -> None:
    x, y, spread = _data(4, 200)
    spread = independent_noise(spread.diagonal)
    base = inducing.build_basis(_KERNEL, x[:40])
    blocks = np.array_split(np.arange(200), 5)
    residual, variance = inducing.sparse_held_out_residuals(base, x, y, spread, blocks)
    kept = np.concatenate(blocks[1:])
    alone = inducing.sparse_posterior(
        base,
        inducing.sufficient_sums(base, x[kept], y[kept], independent_noise(spread.diagonal[kept])),
    )
    cross = inducing.se_kernel(
        x[blocks[0]] / _KERNEL.scales, base.centres / _KERNEL.scales, _KERNEL.amplitude
    )
    assert np.allclose(
        residual[blocks[0]], y[blocks[0]] - cross @ alone.weights.T - alone.mean, atol=1e-6
    )
    left = _KERNEL.amplitude - np.square(cross @ alone.factor.T).sum(axis=1)
    assert np.allclose(variance[blocks[0]], left + 0.05 + _KERNEL.noise)


def test_more_than_the_exact_limit_is_condensed() -> None:
    x, y, _ = _data(5, 700)
    found = FittedKernels((slice(0, 2),), (_KERNEL,), (independent_noise(np.full(700, 0.05)),))
    gp = build_gp(Samples(x, y, np.zeros(y.shape)), found, ("u", "v"), "px")
    assert len(gp.centres) < 300 and len(gp.samples) == 700

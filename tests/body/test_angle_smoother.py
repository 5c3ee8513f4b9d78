import numpy as np
import pytest

from bodylog.body.data.angle_smoother import (
    ReadingChain,
    WhiteMotion,
    build_reading_chain,
    covariance_between_times,
    fit_white_motion,
    smooth_angles,
)
from bodylog.types import Array


def _wiener(a: Array, b: Array, order: int, density: float) -> Array:
    """Covariance of the order-fold integral of white noise, by fine quadrature."""
    grid = (np.arange(4000) + 0.5) / 4000 * max(a.max(), b.max())
    width = grid[1] - grid[0]
    lean = [np.where(grid < x[:, None], x[:, None] - grid, 0.0) ** (order - 1) for x in (a, b)]
    return density * width * lean[0] @ lean[1].T / (1.0 if order == 2 else 4.0)


def _dense(t: Array, z: Array, at: Array, motion: WhiteMotion) -> tuple[Array, Array]:
    """Posterior mean and covariance at `at` in full matrices, with a wide prior on the start."""
    start, scale = t[0], 1e4
    both = np.concatenate([t, at]) - start
    prior = _wiener(both, both, motion.order, motion.process)
    prior += scale * sum(np.outer(both**k, both**k) for k in range(motion.order))
    n = len(t)
    gain = np.linalg.solve(prior[:n, :n] + motion.encoder * np.eye(n), prior[:n, n:]).T
    return gain @ z, prior[n:, n:] - gain @ prior[:n, n:]


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_posterior_and_coupling_are_those_of_a_dense_gaussian(order: int, seed: int) -> None:
    draw = np.random.default_rng(seed)
    t = np.cumsum(draw.uniform(0.03, 0.09, 40)) + 5.0
    z = np.sin(t) + draw.normal(0, 0.05, 40)
    at = np.sort(draw.uniform(t[0], t[-1], 15))
    motion = WhiteMotion(order, 2.0, 0.05**2, 0.0, (0.0, 0.0))
    signal = build_reading_chain(t, z)
    mean, variance = smooth_angles(signal, motion, at)
    expected, covariance = _dense(t, z, at, motion)
    assert np.abs(mean - expected).max() < 1e-3
    assert np.allclose(variance, np.diag(covariance), rtol=0.02)
    i, j, value = covariance_between_times(signal, motion, at)
    rebuilt = np.diag(variance)
    rebuilt[i, j] = rebuilt[j, i] = value
    assert (i > j).all()
    assert np.abs(rebuilt - covariance).max() < 0.02 * variance.max()


@pytest.mark.parametrize("encoder", [0.003, 0.02])
def test_evidence_finds_the_noise_and_its_own_error_bar(encoder: float) -> None:
    wrong = []
    for seed in range(10):
        draw = np.random.default_rng(seed)
        t = np.arange(0, 20, 0.01)
        rate = np.cumsum(draw.normal(0, np.sqrt(0.5 * 0.01), len(t)))
        z = np.cumsum(rate) * 0.01 + draw.normal(0, encoder, len(t))
        found = fit_white_motion([build_reading_chain(t, z)], 2)
        truth = np.array([0.5, encoder**2])
        wrong.append((np.array([found.process, found.encoder]) - truth) / np.array(found.std_error))
    assert np.abs(np.mean(wrong, axis=0)).max() < 1.2
    assert 0.3 < np.mean(np.square(wrong)) < 2.5


def test_fit_of_two_logs_has_smaller_std_error() -> None:
    draw = np.random.default_rng(0)
    t = np.arange(0, 10, 0.02)
    logs = [build_reading_chain(t, np.sin(t + k) + draw.normal(0, 0.01, len(t))) for k in range(2)]
    one, both = fit_white_motion(logs[:1], 2), fit_white_motion(logs, 2)
    assert both.encoder == pytest.approx(1e-4, rel=0.15)
    assert both.std_error[1] < 0.8 * one.std_error[1]


@pytest.mark.parametrize("seed", range(5))
def test_smoothed_angles_have_true_error_bars(seed: int) -> None:
    draw = np.random.default_rng(seed)
    t = np.arange(0, 20, 0.02)
    truth = 0.4 * np.sin(0.9 * t) + 0.2 * np.sin(2.1 * t + seed)
    signal = build_reading_chain(t, truth + draw.normal(0, 0.02, len(t)))
    mean, variance = smooth_angles(signal, max((fit_white_motion([signal], k) for k in (2, 3)), key=lambda m: m.evidence), t[5:-5])
    error = mean - truth[5:-5]
    assert np.sqrt(np.mean(error**2)) < 0.006
    assert 0.4 < np.mean(error**2 / variance) < 1.8


def test_angles_are_unknown_outside_the_readings_and_gaps_widen_error_bars() -> None:
    t = np.concatenate([np.arange(0, 5, 0.05), np.arange(8, 12, 0.05)])
    signal = build_reading_chain(t, np.sin(t) + np.random.default_rng(0).normal(0, 0.01, len(t)))
    motion = fit_white_motion([signal], 2)
    mean, variance = smooth_angles(signal, motion, np.array([-0.1, 2.5, 6.5, 12.5]))
    assert np.isnan(mean[[0, 3]]).all() and np.isnan(variance[[0, 3]]).all()
    assert variance[2] > 50 * variance[1]


def test_readings_may_be_out_of_order_repeated_or_missing() -> None:
    draw = np.random.default_rng(0)
    t = np.repeat(np.arange(0, 10, 0.02), 2)
    z = np.sin(t) + draw.normal(0, 0.01, len(t))
    t, z = np.append(t, 5.0), np.append(z, np.nan)
    order = draw.permutation(len(t))
    one, other = build_reading_chain(t, z), build_reading_chain(t[order], z[order])
    assert isinstance(one, ReadingChain) and len(one.t) == 500
    assert np.allclose(one.total, other.total) and one.count.sum() == len(t) - 1
    assert fit_white_motion([one], 2).encoder == pytest.approx(1e-4, rel=0.2)


def test_fit_counts_a_repeated_message_once() -> None:
    t = np.arange(0, 10, 0.008)
    z = np.sin(t) + np.random.default_rng(0).normal(0, 0.01, len(t))
    again = build_reading_chain(np.sort(np.concatenate([t + k * 0.002 for k in range(4)])), np.repeat(z, 4))
    assert fit_white_motion([again], 3).encoder == pytest.approx(1e-4, rel=0.15)


def test_fast_encoders_share_nodes() -> None:
    t = np.arange(0, 5, 0.001)
    signal = build_reading_chain(t, np.sin(t) + np.random.default_rng(0).normal(0, 0.01, len(t)))
    assert len(signal.t) <= 501
    assert fit_white_motion([signal], 2).encoder == pytest.approx(1e-4, rel=0.1)

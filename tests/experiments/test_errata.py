"""Every erratum of docs/paper.md, derived again by numbers from the printed constants."""

import numpy as np
import pytest

from bodylog.experiments import errata
from bodylog.experiments.cases import drawn_samples
from bodylog.experiments.e6_cost import count_step
from bodylog.experiments.printed import DT, LAMBDA

SCALE = np.exp(0.1)
NOISE_VARIANCE = np.exp(0.02) ** 2
STILL = np.array([[0.3, -0.9, 0.6]])


@pytest.fixture(scope="module")
def printed_map():
    """The map of 46 samples with the printed l and σ_n."""
    return drawn_samples(seed=0).map({})


def kernel(map_of_samples):
    apart = (map_of_samples.x[:, None] - map_of_samples.x) / SCALE
    return np.exp(-0.5 * np.square(apart).sum(axis=2))


def test_prior_with_its_own_rate_grows_beyond_any_angle():
    assert errata.grow_belief(STILL, as_printed=True) > 14 and errata.grow_belief(STILL, as_printed=False) < 0


def test_prior_alone_grows_by_the_factor_of_its_rate():
    """μ̇ = μ: (1 + Δt)^1200 in 60 s, some 10²⁵."""
    assert pytest.approx(2.7e25, rel=0.02) == (1.0 + LAMBDA * DT) ** (errata.LASTING_S / DT)


def test_explicit_step_is_stable_in_scatters_and_not_in_pixels(printed_map):
    x = np.median(printed_map.x, axis=0)
    slope = np.linalg.norm(errata.slope_by_differences(printed_map, x), 2)
    in_px, in_scatters = (errata.find_stable_step(printed_map, x, unit) for unit in (1.0, printed_map.scatter))
    assert in_px < 2e-4 < DT / 100 and in_scatters > 100 * in_px
    assert in_px == pytest.approx(5.0 / slope**2, rel=0.3), "Δt < σ_v/|J|²"


def test_step_at_the_limit_is_the_one_that_neither_shrinks_nor_grows(printed_map):
    """Below the limit Algorithm 1 settles, above it does not, run as the experiments run it."""
    x = np.median(printed_map.x, axis=0)
    limit = errata.find_stable_step(printed_map, x, printed_map.scatter)
    found = {}
    for factor in (0.9, 1.2):
        found[factor] = _run_linear(errata.slope_by_differences(printed_map, x) / printed_map.scatter, factor * limit)
    assert found[0.9] < 1.0 < found[1.2]


def _run_linear(slope, dt):
    """How much an error of 0.01 rad has grown after many steps of the linear system, written out."""
    x, mu, ex, ep, ev = np.full(3, 0.01), np.full(3, 0.01), np.zeros(3), np.zeros(3), np.zeros(2)
    for _ in range(20000):
        dx = slope.T @ ev + ep - ex
        dev, dep, dex, dmu = -slope @ x - 5.0 * ev, -x - ep, x - mu - ex, ex
        x, mu, ex, ep, ev = x + dt * dx, mu + dt * dmu, ex + dt * dex, ep + dt * dep, ev + dt * dev
        if not np.abs(x).max() < 1e6:
            break
    return float(np.abs(x).max() / 0.01)


def test_printed_jacobian_is_wrong_by_the_fourth_power_of_the_scale(printed_map):
    x = np.median(printed_map.x, axis=0) + 0.05
    apart = x - printed_map.x
    weighted = np.exp(-0.5 * np.square(apart / SCALE).sum(axis=1))[:, None] * printed_map.weights
    slope = errata.slope_by_differences(printed_map, x)
    printed = -np.einsum("nd,nm->dm", weighted, apart * SCALE**2)
    correct = -np.einsum("nd,nm->dm", weighted, apart / SCALE**2)
    assert np.allclose(correct, slope, rtol=1e-6, atol=1e-6 * np.abs(slope).max())
    assert np.abs(printed - slope).max() / np.abs(slope).max() == pytest.approx(SCALE**4 - 1.0, rel=1e-6)
    assert pytest.approx(0.492, abs=5e-4) == SCALE**4 - 1.0


def test_noise_on_every_entry_leaves_the_covariance_singular(printed_map):
    k = kernel(printed_map)
    everywhere = np.linalg.eigvalsh(k + NOISE_VARIANCE)
    diagonal = np.linalg.eigvalsh(k + NOISE_VARIANCE * np.eye(len(k)))
    assert len(k) == 46 and abs(everywhere[0]) < 1e-9 * NOISE_VARIANCE
    assert diagonal[0] == pytest.approx(NOISE_VARIANCE, rel=1e-9)
    assert everywhere[0] <= np.linalg.eigvalsh(k)[1] + 1e-9, "a matrix of rank one moves one eigenvalue"


def test_free_energy_as_printed_is_ascended():
    """F = −(s − x)²/2: +∂F/∂x comes to s, −∂F/∂x leaves it by the factor (1 + Δt) a step."""
    ends = {}
    for sign in (1.0, -1.0):
        x = 0.1
        for _ in range(100):
            x += sign * DT * (0.0 - x)
        ends[sign] = x
    assert ends[1.0] < 0.001 and ends[-1.0] == pytest.approx(0.1 * 1.05**100) and ends[-1.0] > 10


def test_step_costs_the_product_of_senses_and_joints():
    assert [count_step(n, n, n) for n in (8, 16)] == [64, 256] and 256 > 16 + 16


def test_prior_error_as_in_the_algorithm_comes_to_its_definition():
    """ė_x = x̂ − μ − σ_x e_x settles at (x̂ − μ)/σ_x, which is e_x's definition."""
    e, x, mu, sigma = 0.0, 0.4, 0.1, 2.0
    for _ in range(1000):
        e += DT * (x - mu - sigma * e)
    assert e == pytest.approx((x - mu) / sigma)

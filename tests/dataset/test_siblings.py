"""Outliers among siblings, held to the definition: each value against the others, one at a time."""

import numpy as np
import pytest
from scipy.stats import norm, t

from bodylog.dataset.siblings import (
    FALSE_ALARMS,
    OTHER_DELAY_NATS,
    STATED_READINGS,
    find_other_delays,
    find_outliers,
)

LOOKS = 50
RESOLUTION = 0.01


def distance_over_bound(values: np.ndarray, std: np.ndarray, k: int) -> float:
    """Distance of value k from the others, over its bound."""
    tail = 0.5 * FALSE_ALARMS / LOOKS
    others, errors = np.delete(values, k), np.delete(std, k)
    count = len(others)
    if errors.all():
        weights = 1.0 / (errors**2 + RESOLUTION**2)
        mean = np.average(others, weights=weights)
        misfit = (weights * (others - mean) ** 2).sum()
        scale = (STATED_READINGS + misfit) / (STATED_READINGS + count - 1)
        spread = np.sqrt(scale * (std[k] ** 2 + RESOLUTION**2 + 1.0 / weights.sum()))
        return float(abs(values[k] - mean) / spread / t.isf(tail, count - 1 + STATED_READINGS))
    spread = others.std(ddof=1) * np.sqrt(1.0 + 1.0 / count)
    bound = np.hypot(t.isf(tail, count - 1) * spread, norm.isf(tail) * np.hypot(std[k], RESOLUTION))
    return float(abs(values[k] - others.mean()) / bound)


@pytest.mark.parametrize("stated", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("far", [3.0, 1e6])
def test_the_farthest_value_is_judged_as_the_definition_says(far: float, stated: float) -> None:
    """With standard errors of no, some and all values: and beside a value that is far beyond all rounding."""
    rng = np.random.default_rng(int(10 * stated))
    for _ in range(20):
        values = rng.normal(2.0, 0.1, 12)
        std = np.where(rng.random(12) < stated, rng.uniform(0.05, 0.2, 12), 0.0)
        values[rng.integers(12)] += far
        (first, *_) = find_outliers(values, std, RESOLUTION, LOOKS)
        assert first.z / first.bound == pytest.approx(distance_over_bound(values, std, first.number), rel=1e-6)


def test_two_far_values_do_not_hide_each_other() -> None:
    values = np.random.default_rng(4).normal(0.0, 0.1, 20)
    values[[3, 11]] += [5.0, 5.2]
    found = find_outliers(values, np.zeros(20), RESOLUTION, LOOKS)
    assert sorted(one.number for one in found) == [3, 11]


def test_values_without_a_number_are_left_out() -> None:
    values = np.array([0.0, np.nan, 0.01, 0.02, 0.0, 9.0, np.nan, 0.01])
    assert [one.number for one in find_outliers(values, np.zeros(8), RESOLUTION, LOOKS)] == [5]
    assert not find_outliers(values[:4], np.zeros(4), RESOLUTION, LOOKS)


DELAYS_S = np.arange(-15, 26) * 0.02


def profiles_of(delays_s: list[float], nats: float) -> np.ndarray:
    """Log likelihoods (N,K) with a top at each delay, from which delays 0.1 s away are `nats` less."""
    distance = np.abs(DELAYS_S[None] - np.array(delays_s)[:, None]) / 0.1
    return -nats * np.minimum(distance**2, 1.0)


def test_an_episode_whose_pictures_fit_another_delay_stands_out_though_none_is_measured() -> None:
    profiles = profiles_of([0.06, 0.06, 0.04, 0.2, 0.06, 0.08, 0.06, 0.06], 1.5 * OTHER_DELAY_NATS)
    (one,) = find_other_delays(profiles, DELAYS_S)
    assert one.number == 3
    assert one.value == pytest.approx(0.2) and one.others == pytest.approx(0.06)
    assert one.z**2 / 2.0 == pytest.approx(1.5 * OTHER_DELAY_NATS)
    assert not find_other_delays(profiles / 2.0, DELAYS_S)
    assert not find_other_delays(np.where(np.arange(8)[:, None] > 3, np.nan, profiles), DELAYS_S)


def test_one_sure_episode_does_not_decide_for_the_others() -> None:
    profiles = profiles_of([0.06] * 7 + [0.2], 2.0 * OTHER_DELAY_NATS)
    profiles[7] *= 100.0
    assert [one.number for one in find_other_delays(profiles, DELAYS_S)] == [7]


def test_episodes_without_a_common_delay_accuse_nobody() -> None:
    delays_s = [-0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.4, 0.06]
    assert not find_other_delays(profiles_of(delays_s, 4.0 * OTHER_DELAY_NATS), DELAYS_S)

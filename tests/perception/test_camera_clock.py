"""A camera's clock from a recorder's stamps: found where the recorder's beat explains them, refused elsewhere."""

import numpy as np
import pytest

from bodylog.perception.surface.camera_clock import fit_camera_clock
from bodylog.types import Array

SEEDS = range(6)


def store_pictures(taken: Array, ticks: Array) -> tuple[Array, Array, Array]:
    """Stamps of the frames that a recorder stores at its ticks (s), which repeat the one before, and when the picture
    of each was taken (s)."""
    latest = np.searchsorted(taken, ticks, side="right") - 1
    ticks, latest = ticks[latest >= 0], latest[latest >= 0]
    return ticks, np.diff(latest, prepend=-1) == 0, taken[latest]


def draw_recording(
    seed: int, period: float, jitter: float = 0.001, lost: float = 0.01, length: float = 12.0
) -> tuple[Array, Array, Array]:
    """A regular camera with lost pictures before a recorder at 30 Hz that dates frames k/30."""
    rng = np.random.default_rng(seed)
    taken = rng.uniform(0.0, period) + period * np.arange(int(length / period))
    taken = np.sort(taken + rng.normal(0.0, jitter, len(taken)))[rng.uniform(size=len(taken)) > lost]
    return store_pictures(taken, np.arange(int(length * 30)) / 30)


def scatter(dates: Array, taken: Array) -> float:
    """Standard deviation (s) of dates about the true times, whatever delay they have in common."""
    return float((dates - taken).std())


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("hz", [15.1, 14.93, 12.4, 25.0, 10.0, 7.3])
def test_pictures_are_dated_to_a_fraction_of_the_recorders_beat(seed: int, hz: float) -> None:
    t, repeated, taken = draw_recording(seed, 1.0 / hz)
    clock = fit_camera_clock(t, repeated)
    new = ~repeated
    assert clock is not None and 1.0 / clock.period_s == pytest.approx(hz, rel=5e-3)
    found = scatter(clock.date_pictures(t[new]), taken[new])
    assert found < 0.0035 and found < max(0.5 * scatter(t[new], taken[new]), 0.002)
    # the delay of the stamps is kept
    assert np.mean(clock.date_pictures(t[new]) - t[new]) == pytest.approx(0.0, abs=0.001)


@pytest.mark.parametrize("seed", SEEDS)
def test_repeats_that_are_not_seen_get_the_time_of_their_picture(seed: int) -> None:
    t, repeated, taken = draw_recording(seed, 1.0 / 15.1)
    slow = np.random.default_rng(seed).choice(np.flatnonzero(repeated), 15, replace=False)
    repeated[slow] = False
    clock = fit_camera_clock(t, repeated)
    assert clock is not None
    t, taken = t[~repeated], taken[~repeated]
    dates = clock.date_pictures(t)
    assert (np.diff(dates) == 0.0).sum() >= 12
    assert scatter(dates, taken) < 0.01 and scatter(dates, taken) < 0.6 * scatter(t, taken)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_camera_of_varying_rate_has_no_clock(seed: int) -> None:
    """Its exposure lasts 50 to 80 ms, as the light asks; a film of constant rate stores pictures again."""
    rng = np.random.default_rng(seed)
    taken = np.cumsum(rng.uniform(0.05, 0.08, 200))
    t, repeated, _ = store_pictures(taken, np.arange(360) / 30)
    assert fit_camera_clock(t, repeated) is None


@pytest.mark.parametrize("seed", SEEDS)
def test_a_camera_whose_rate_drifts_has_no_clock(seed: int) -> None:
    """Its rate rises and falls by 6 % in 10 s; nearly every second frame of the recorder is new all the same."""
    swing = np.sin(np.arange(200) / 25.0 + seed)
    t, repeated, _ = store_pictures(np.cumsum((1.0 + 0.06 * swing) / 15.0), np.arange(390) / 30)
    assert fit_camera_clock(t, repeated) is None


@pytest.mark.parametrize("seed", SEEDS)
def test_true_stamps_are_left_alone(seed: int) -> None:
    """Stamps of the camera itself, with its jitter, some pictures sent twice; and those of a recorder that is slower
    than its camera."""
    rng = np.random.default_rng(seed)
    own = np.arange(200) / 15.0 + rng.normal(0.0, 0.006, 200)
    twice = np.sort(np.concatenate([own, own[rng.uniform(size=200) < 0.5] + 0.03]))
    assert fit_camera_clock(twice, np.isin(twice, own, invert=True)) is None
    assert fit_camera_clock(own, np.zeros(200, bool)) is None
    t, repeated, _ = draw_recording(seed, 1.0 / 47.0)
    assert fit_camera_clock(t, repeated) is None


def test_few_or_equal_stamps_have_no_clock() -> None:
    for t in (np.zeros(0), np.zeros(1), np.zeros(100), np.arange(30) / 30):
        repeated = np.arange(len(t)) % 2 == 1
        assert fit_camera_clock(t, repeated) is None
    t = np.arange(200) / 30
    assert fit_camera_clock(t, np.ones(200, bool)) is None
    steady = fit_camera_clock(t, np.arange(200) % 2 == 1)
    assert steady is not None
    np.testing.assert_allclose(steady.date_pictures(t[::2]), t[::2], atol=1e-3)

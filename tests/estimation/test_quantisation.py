"""Encoders that count in coarse steps: their noise is that of the step, however often a reading repeats."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.estimation.noise import quantisation
from bodylog.estimation.noise.quantisation import (
    compute_quantisation_variance,
    compute_relative_variances,
    compute_repeat_factor,
    dither_readings,
    find_reading_step,
)
from bodylog.evaluation.scores import truth_at_times
from bodylog.settings import EstimationSettings
from tests.estimation.resting import Drawn, drawn
from tests.seeds import first_of


def test_step_size_is_found_only_for_coarse_encoders():
    rng = np.random.default_rng(0)
    y = np.sin(np.arange(0.0, 10.0, 0.02))
    for without_step in (y, y + rng.normal(0, 0.01, len(y)), np.full(20, 0.3)):
        assert find_reading_step(without_step) == 0.0
    assert find_reading_step(np.round(y / 0.01) * 0.01) == pytest.approx(0.01)
    assert find_reading_step(np.round((y + rng.normal(0, 0.004, len(y))) / 0.0015) * 0.0015) == pytest.approx(0.0015)


def test_dither_is_as_wide_as_the_step_and_the_same_every_time():
    t = np.arange(0.0, 4.0, 1e-3)
    y = np.round(t / 0.02) * 0.02
    spread, variance, least = dither_readings(t, y)
    assert least == variance == pytest.approx(0.02**2 / 12)
    assert np.var(spread - y) == pytest.approx(variance, rel=0.1)
    np.testing.assert_array_equal(spread, dither_readings(t, y)[0])
    smooth, *none = dither_readings(t, np.sin(t))
    assert none == [0.0, 0.0] and (smooth == np.sin(t)).all()


def test_readings_that_repeat_for_long_share_an_error():
    t = np.arange(0.0, 8.0, 0.02)
    _, variance, least = dither_readings(t, np.round(t / 4.0) * 0.02)
    assert 10 * variance < least < 30 * variance


@pytest.mark.parametrize("seed", range(3))
def test_readings_that_differ_by_rounding_are_the_same(seed):
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 10.0, 0.01)
    y = np.round(np.sin(0.01 * t + seed) / 0.002) * 0.002
    moved = y + 1e-14 * rng.standard_normal(len(y))
    assert compute_repeat_factor(t, moved) == compute_repeat_factor(t, y) > 1.0
    assert compute_quantisation_variance(moved) == pytest.approx(compute_quantisation_variance(y), rel=1e-9)
    assert compute_relative_variances(t, moved, 1e-6) == pytest.approx(compute_relative_variances(t, y, 1e-6))


def test_slow_readings_that_differ_share_none():
    t = np.arange(0.0, 20.0, 1.0)
    assert compute_repeat_factor(t, np.sin(t)) == 1.0
    assert compute_repeat_factor(t, np.repeat(np.sin(t[::2]), 2)) == 2.0


@pytest.mark.parametrize("method", ["filter", "smoother"])
@pytest.mark.parametrize(("step", "speed"), [(0.05, 0.15), (0.05, 0.5), (0.01, 0.15), (0.005, 0.05)])
@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.soak), 1])
def test_error_bars_are_true_for_coarse_encoders(world, method, step, speed, seed):
    drawn = world(seed, duration=12.0, encoder_std=0.0, speed=speed)
    joints = drawn.features.joints
    coarse = replace(joints, values=np.round(joints.values / step) * step)
    found = estimate_from_features(replace(drawn.features, joints=coarse), drawn.body, EstimationSettings(method=method))
    assert not found.faults
    error = found.joints.values - drawn.truth.values
    ratio = error**2 / np.einsum("nii->ni", found.cov)
    assert 0.3 < ratio.mean() < 2.5
    assert np.sqrt(np.mean(error**2)) < step / np.sqrt(12.0)


@pytest.mark.parametrize("method", ["filter", "smoother"])
def test_belief_of_constant_readings_has_true_error_bars(world, method):
    drawn = world(1, duration=12.0, encoder_std=0.0, speed=0.0)
    joints = drawn.features.joints
    off = np.array([0.004, -0.003, 0.002])
    encoder = tuple([0.003**2] * 3)
    body = replace(drawn.body, noise=replace(drawn.body.noise, encoder=encoder), senses={})
    features = replace(drawn.features, joints=replace(joints, values=joints.values + off), tracks={})
    found = estimate_from_features(features, body, EstimationSettings(method=method))
    columns = [joints.names.index(name) for name in body.joints]
    assert np.mean(off[columns] ** 2 / np.einsum("nii->ni", found.cov)) < 3.0


@pytest.mark.parametrize("method", ["filter", "smoother"])
@pytest.mark.parametrize("motion", ["rest", "slow", "reach"])
@pytest.mark.parametrize("noise", first_of(1, [0.2, 0.05, 0.35]))
def test_error_bars_of_counted_readings_are_true_at_any_rate(method, motion, noise):
    """Noise that moves few readings to the next count; NEES of up to 95 where each reading was one more."""
    for seed, rate in ((600, 50.0), (601, 500.0)):
        how = Drawn(motion, step=1.5e-3, noise=noise * 1.5e-3, encoder_hz=rate, camera_hz=20.0, pixel=0.3)
        world = drawn(seed, how)
        found = estimate_from_features(world.features, world.body, EstimationSettings(method=method))
        assert not found.faults
        off = found.joints.values - truth_at_times(world.truth, list(found.joints.names), found.joints.t)
        assert np.mean(off**2 / np.einsum("nii->ni", found.cov)) < (3.0 if motion == "rest" else 2.0)


def test_what_readings_of_one_place_have_in_common_is_what_they_do_not_average():
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 40.0, 1e-3)
    for noise in (0.0, 0.1, 0.2, 0.3):
        errors = []
        for place in rng.uniform(0.0, 1.0, 400):
            read = np.round(place + noise * rng.normal(0.0, 1.0, 2000))
            errors.append(read.mean() - place)
        slow = np.round(0.5 * t + noise * rng.normal(0.0, 1.0, len(t)))
        share = quantisation._find_stays(t, slow).share
        assert share == pytest.approx(12.0 * np.mean(np.square(errors)), rel=0.25, abs=0.03)

"""Encoders that count in steps and joints at rest: sound ones, with finite results by every method."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.errors import EvidenceError
from bodylog.estimation import METHODS, estimate_from_features
from bodylog.estimation.faults.repeats import find_frozen_readings
from bodylog.estimation.faults.threshold import EVIDENCE_THRESHOLD_NATS
from bodylog.estimation.methods.consistency import require_finite_estimate
from bodylog.settings import EstimationSettings
from tests.estimation import conftest as worlds
from tests.estimation.resting import Drawn, drawn, judged
from tests.seeds import first_of, seeds


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("step", [1e-6, 1.5e-3])
def test_methods_give_finite_results_for_a_mostly_resting_arm(method, step):
    world = drawn(0, Drawn("reach", step, encoder_hz=100.0))
    assert np.mean(np.diff(world.features.joints.values, axis=0) == 0.0) > 0.4
    found = estimate_from_features(world.features, world.body, EstimationSettings(method=method))
    assert require_finite_estimate(found) is found and not found.faults


@pytest.mark.parametrize("method", ["filter", "smoother"])
@pytest.mark.parametrize("senses", [None, ("encoders",)])
@pytest.mark.parametrize(("step", "noise"), [(1e-6, 0.0), (1e-4, 0.0), (1.5e-3, 0.0), (0.01, 0.0), (1.5e-3, 1e-3)])
@pytest.mark.parametrize("moves", first_of(1, ["reach", "slow", "sines"]))
@pytest.mark.parametrize("seed", seeds(1, 5))
def test_encoder_noise_of_quantised_readings_is_the_step(method, senses, step, noise, moves, seed):
    world = drawn(seed, Drawn(moves, step, noise))
    found = estimate_from_features(world.features, world.body, EstimationSettings(method=method, senses=senses))
    error, nees = judged(world, found.joints, found.cov)
    assert error < 0.75 * max(step, noise) and nees < 1.8
    # variances are bounded at a microradian, the body's counts a little, and a joint at rest may be off by half a step
    assert nees > (0.4 if noise else 0.005 if step < 1e-5 else 0.15)


@pytest.mark.parametrize("seed", [100, 101, 102, 103])
def test_rounding_leaves_variances_of_near_exact_encoders_positive(seed):
    world = drawn(seed, Drawn("sines", 1e-6, encoder_hz=100.0, camera_hz=30.0))
    found = estimate_from_features(world.features, world.body, EstimationSettings())
    assert found.settings["motion"] == "white-jerk" and require_finite_estimate(found) is found


@pytest.mark.parametrize("seed", [300, 304, 305])
def test_encoder_noise_is_not_taken_for_the_motion_of_quick_reaches(white_acceleration, seed):
    """White acceleration fits rest and reaches best as if there were hardly any noise."""
    world = drawn(seed, Drawn("reach", noise=1e-3, encoder_hz=20.0))
    found = estimate_from_features(world.features, world.body, EstimationSettings(senses=("encoders",)))
    np.testing.assert_allclose(np.sqrt(found.settings["encoder"]), 1e-3, rtol=0.3)
    assert judged(world, found.joints, found.cov)[1] < 1.5


@pytest.mark.parametrize("method", ["filter", "smoother", "ekf"])
def test_estimate_follows_a_joint_after_a_long_rest(method):
    world = drawn(0, Drawn("reach", 1e-4))
    found = estimate_from_features(world.features, world.body, EstimationSettings(method=method, senses=("encoders",)))
    truth = np.stack([np.interp(found.joints.t, world.truth.t, column) for column in world.truth.values.T], axis=1)
    assert np.abs(found.joints.values - truth).max() < 1e-3


def test_error_bars_of_joints_at_rest_that_images_determine_are_stated_nearly_whole():
    """Images' errors last; of what encoders alone tell, a quarter is motion, and there is none."""
    each = []
    for seed in range(4):
        world = drawn(seed, Drawn("rest", noise=0.01, encoder_hz=100.0, camera_hz=20.0, pixel=0.03))
        for senses in (None, ("encoders",)):
            found = estimate_from_features(world.features, world.body, EstimationSettings(senses=senses))
            stated = np.array(found.settings["stated"])
            assert (stated > 0.8).all() if senses is None else (stated < 0.77).all()
            each.append(judged(world, found.joints, found.cov)[1])
    assert 0.8 < np.mean(each) < 1.2


def ramped(t, rng, speed):
    """Moves from rest to rest: speed (rad/s) rises and falls evenly, within a tenth of a second."""
    x = np.tile(np.array([-0.9, -0.9, 1.0]), (len(t), 1))
    for begin in np.arange(2.0, 18.0, 4.0) + rng.uniform(0.0, 2.0, 4):
        lasting, rise = rng.uniform(0.2, 0.4), rng.uniform(0.05, 0.1)
        level, sloped = (np.square(np.clip(t - begin - late, 0.0, lasting)) / 2.0 for late in (0.0, rise))
        beyond = np.maximum(t - begin - lasting, 0.0) - np.maximum(t - begin - rise - lasting, 0.0)
        x += np.outer((level - sloped + lasting * beyond) / rise, rng.uniform(-2.5, 2.5, 3) * speed)
    return x


@pytest.mark.parametrize("method", ["filter", "smoother"])
@pytest.mark.parametrize("first", seeds(1, 6))
def test_estimate_follows_joints_that_start_and_stop_within_a_few_readings(world, monkeypatch, method, first):
    """Their first and last bends stand alone, as those of false readings do."""
    monkeypatch.setattr(worlds, "motion", ramped)
    errors = []
    for seed in range(4 * first, 4 * first + 4):
        drawn = world(seed, encoder_hz=30.0, encoder_std=1e-3, speed=1.0)
        found = estimate_from_features(drawn.features, drawn.body, EstimationSettings(method=method, senses=("encoders",)))
        error, nees = judged(drawn, found.joints, found.cov)
        errors.append(error)
        assert 0.3 < nees < 3.0
    assert np.mean(errors) < 1.02e-3


@pytest.mark.parametrize(
    ("field", "text"),
    [
        ("joints", "the angle of lift at 0.060 s is not a number by filter"),
        ("rate", "the rate of lift at 0.060 s"),
        ("cov", "the variance of lift at 0.060 s"),
        ("free_energy", "the free energy at 0.060 s"),
    ],
)
def test_estimates_contain_no_nan(world, field, text):
    found = estimate_from_features(*(lambda w: (w.features, w.body))(world(0, duration=2.0)), EstimationSettings())
    bad = getattr(found, field)
    values = np.array(bad if isinstance(bad, np.ndarray) else bad.values)
    values[(3, 1) if values.ndim > 1 else 3] = np.nan
    with pytest.raises(EvidenceError, match=text):
        require_finite_estimate(replace(found, **{field: values if isinstance(bad, np.ndarray) else replace(bad, values=values)}))


def test_frozen_takes_rounding_alone_for_no_noise():
    """In motion, readings in steps scatter as noise does; yet they repeat while the joint is still."""
    joints = drawn(102, Drawn("reach", step=0.0015)).features.joints
    for k, name in enumerate(joints.names):
        runs = list(find_frozen_readings(joints.t, joints.values[:, k], lambda begin, end: 0.0))
        assert runs and not any(run.nats > EVIDENCE_THRESHOLD_NATS for run in runs), name

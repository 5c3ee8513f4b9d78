"""Variances typed in the settings: used as they are, by every method, live and in batches."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog import Estimator
from bodylog.config import merge_settings, settings_as_toml
from bodylog.errors import ConfigError, UsageError
from bodylog.estimation import estimate_from_features
from bodylog.estimation.methods.grid import build_grid_problem
from bodylog.settings import EstimationSettings, Settings, settings_as_values
from tests.estimation.conftest import strokes

SIGMA, PROCESS, PIXEL = {"pan": 1e-4, "lift": 4e-4, "elbow": 9e-4}, 0.2, 0.5


def asked(half=1.0, **others):
    """Typed in full, so that nothing is left to be learned."""
    encoders = {name: half * value for name, value in SIGMA.items()}
    typed = {"sigma_encoders": encoders, "sigma_vision": PIXEL, "process": PROCESS}
    return EstimationSettings(precision="model", bias="off", **{**typed, **others})


@pytest.mark.parametrize("method", ["filter", "ekf", "smoother"])
@pytest.mark.parametrize("half", [1.0, 0.5])
def test_belief_with_given_variances_is_the_kalman_filters(world, reference, linear_model, method, half):
    drawn = world(3, duration=6.0, model=linear_model, encoder_std=0.005)  # within the gate
    found = estimate_from_features(drawn.features, drawn.body, asked(half, method=method))
    encoder = half * np.array(list(SIGMA.values()))
    book = reference(drawn, np.full(3, PROCESS), encoder, PIXEL)
    mean, cov = (book.smooth, book.smooth_cov) if method == "smoother" else (book.mean, book.cov)
    rows = np.searchsorted(book.t, found.joints.t)
    np.testing.assert_allclose(found.joints.values, mean[rows, :3], atol=1e-9, rtol=0)
    np.testing.assert_allclose(found.cov, cov[rows, :3, :3], rtol=1e-5, atol=1e-12)
    assert found.settings["encoder"] == encoder.tolist() and found.settings["process"] == [PROCESS] * 3


def test_belief_follows_an_encoder_more_with_smaller_variance(world):
    drawn = world(4, duration=6.0, encoder_std=0.005)
    joints = drawn.features.joints
    values = joints.values[:, [joints.names.index(name) for name in drawn.body.joints]]
    off = [
        np.square(estimate_from_features(drawn.features, drawn.body, asked(half)).joints.values - values).mean()
        for half in (1.0, 0.5, 0.05)
    ]
    assert off[0] > 1.1 * off[1] > 2.0 * off[2]


def test_live_filter_uses_given_variances(world):
    drawn = world(5, duration=2.0, encoder_std=0.005)
    settings = asked()
    batch, live = estimate_from_features(drawn.features, drawn.body, settings), Estimator(drawn.body, settings)
    joints, track = drawn.features.joints, drawn.features.tracks["effector"]
    rows = [dict(zip(joints.names, row, strict=True)) for row in joints.values]
    steps = [(t, {"joints": row}) for t, row in zip(joints.t, rows, strict=True)]
    steps += [(t, {"effector": (*place, 9.0, 9.0)}) for t, place in zip(track.t, track.values, strict=True)]
    beliefs = {t: live.step(t, **one) for t, one in sorted(steps, key=lambda one: one[0])}
    np.testing.assert_allclose([beliefs[t].x for t in batch.joints.t], batch.joints.values, atol=1e-9, rtol=0)


def test_learned_variances_do_not_replace_given_ones(world, white_acceleration):
    drawn = world(6, duration=6.0)
    typed = EstimationSettings(sigma_encoders={"lift": 2.5e-4}, sigma_vision={"effector": 0.3}, process={"pan": 0.7})
    found = estimate_from_features(drawn.features, drawn.body, typed).settings
    learned = estimate_from_features(drawn.features, drawn.body, EstimationSettings()).settings
    assert found["encoder"][1] == 2.5e-4 and found["encoder"][0] == learned["encoder"][0]
    assert found["process"][0] == 0.7 and found["process"][1] != 0.7 and found["scale"]["effector"] == 1.0


def test_touch_and_the_rate_of_the_prior_are_typed_for_predictive_coding(world):
    drawn = world(7, duration=12.0)
    typed = {"sigma_touch": 33.0, "sigma_vision": 7.0, "sigma_encoders": 0.01, "lambda_": 0.3}
    settings = EstimationSettings(method="predictive-coding", **typed)
    plan, _, _ = build_grid_problem(strokes(drawn, 1.0), drawn.body, settings)
    sigma = {sense.name: set(np.unique(sense.sigma)) for sense in plan.senses}
    assert sigma == {"encoders": {0.01}, "effector": {7.0}, "touch": {33.0}} and plan.learning == 0.3
    slow, fast = (
        estimate_from_features(drawn.features, drawn.body, replace(settings, lambda_=rate, precision="fixed")).joints.values
        for rate in (0.01, 3.0)
    )
    assert np.abs(slow - fast).max() > 0.005


def test_fixed_says_which_variances_were_used(world):
    drawn = world(8, duration=2.0)
    text_used = "variances used are encoders 1 rad², process 0.3 rad²/s³, effector {} px²"
    typed = f"precision fixed (sigma_vision as typed): {text_used.format(2)}"
    for vision, text in ((None, f"precision fixed: {text_used.format(5)}"), (2.0, typed)):
        found = estimate_from_features(drawn.features, drawn.body, EstimationSettings(precision="fixed", sigma_vision=vision))
        assert text in [finding.text for finding in found.findings]


def test_unknown_names_are_refused_and_ignored_variances_give_a_warning(world):
    drawn = world(9, duration=2.0)
    joints = "pan, lift, elbow"
    for key, possible in (("sigma_encoders", joints), ("process", joints), ("sigma_vision", "effector")):
        with pytest.raises(UsageError, match=f"estimate.{key}: 'wrist' is not one of {possible}"):
            estimate_from_features(drawn.features, drawn.body, EstimationSettings(**{key: {"wrist": 1.0}}))
    (text,) = (
        finding.text
        for finding in estimate_from_features(drawn.features, drawn.body, EstimationSettings(method="kalman", process=1.0)).findings
        if "ignored by" in finding.text
    )
    assert text.startswith("process: 1.0 is ignored by kalman")


def test_given_variances_survive_robot_toml(tmp_path):
    given = {"sigma_encoders": 0.01, "sigma_vision": {"effector": 0.2}, "lambda": 0.5, "process": {"pan": 1}}
    settings = merge_settings(Settings(), {"estimate": given}, "robot.toml")
    assert settings.estimate.sigma_encoders == 0.01 and settings.estimate.lambda_ == 0.5
    assert settings.estimate.process == {"pan": 1.0} and settings_as_values(settings)["estimate"]["lambda"] == 0.5
    again = tmp_path / "robot.toml"
    again.write_text(settings_as_toml(settings))
    from bodylog.config import load_settings

    assert load_settings(again) == settings and "# sigma_touch =\n" in settings_as_toml(settings)
    with pytest.raises(ConfigError, match=r"estimate.sigma_encoders is 0.*from 1e-18"):
        merge_settings(Settings(), {"estimate": {"sigma_encoders": 0.0}}, "robot.toml")
    with pytest.raises(ConfigError, match=r"estimate.process is .*from 1e-18"):
        merge_settings(Settings(), {"estimate": {"process": {"pan": -1.0}}}, "robot.toml")
    with pytest.raises(ConfigError, match="did you mean lambda"):
        merge_settings(Settings(), {"estimate": {"lamda": 1.0}}, "robot.toml")

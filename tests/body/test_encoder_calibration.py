"""Encoder functions, learned from true angles, and used without them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from bodylog.body import learn_body
from bodylog.body.learning import LearnedBody
from bodylog.body.senses.encoder_function import Polynomial, convert_readings_to_angles
from bodylog.body.storage import load_body, save
from bodylog.errors import ConfigError, EvidenceError, UsageError
from bodylog.estimation import METHODS, estimate_from_features
from bodylog.settings import EstimationSettings, Settings
from bodylog.types import Array, Features
from tests.body.conftest import JOINTS, motion

NOISE = 0.003
Reading = Callable[[Array], Array]


def _square(x: Array) -> Array:
    return np.square(x + 1.2)


def _bent(x: Array) -> Array:
    return 0.3 - 1.5 * x + 0.1 * x**3


def _read(
    explored, seed: int, reading: Reading, noise: float = NOISE, duration: float = 20.0
) -> Features:
    """An exploration with a reference of its angles; encoders read `reading` of them."""
    run = explored(seed, 0.0, duration)
    joints = run.features.joints
    noisy = reading(joints.values) + np.random.default_rng(seed).normal(
        0.0, noise, joints.values.shape
    )
    return replace(run.features, joints=replace(joints, values=noisy), reference=joints)


def _score(learned: LearnedBody, name: str) -> float:
    return next(score.value for score in learned.scores if score.name == name)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("reading", [np.square, _square, _bent, lambda x: 0.01 + 1.02 * x])
def test_encoder_functions_are_learned_to_a_fraction_of_their_noise(
    explored, seed, reading
) -> None:
    learned = learn_body([_read(explored, seed, reading)], Settings(), {})
    model = learned.model.senses["encoders"]
    x = explored(seed, 0.0, 20.0).angles
    assert isinstance(model, Polynomial)
    assert np.sqrt(np.square(model.predict(x)[0] - reading(x)).mean()) < 0.15 * NOISE
    assert np.sqrt(learned.model.noise.encoder) == pytest.approx(NOISE, rel=0.06)
    assert _score(learned, "rmse/held_out_encoders/pan") == pytest.approx(NOISE, rel=0.06)
    error = learned.model.senses["effector"].predict(x)[0] - explored(seed, 0.0, 20.0).pixels
    assert np.sqrt(np.mean(error**2)) < 0.25


@pytest.mark.parametrize("seed", range(4))
def test_encoders_that_read_the_angle_itself_get_no_model(explored, seed) -> None:
    learned = learn_body([_read(explored, seed, lambda x: x)], Settings(), {})
    assert set(learned.model.senses) == {"effector"}
    assert np.sqrt(learned.model.noise.encoder) == pytest.approx(NOISE, rel=0.05)
    assert learned.findings[-1].text == "encoders: by the reference they read the angles themselves"


def test_several_logs_are_learned_together(explored) -> None:
    one = [_read(explored, seed, _square, 0.05, 10.0) for seed in range(3)]
    alone, together = (
        learn_body(logs, Settings(), {}).model.senses["encoders"] for logs in (one[:1], one)
    )
    x = np.column_stack([np.linspace(low, low + 0.6, 50) for low in (-0.3, 0.0, 0.3)])
    errors = [np.square(model.predict(x)[0] - _square(x)).mean() for model in (alone, together)]
    assert errors[1] < errors[0]


@pytest.mark.parametrize("reading", [_square, _bent])
@pytest.mark.parametrize("method", ["filter", "smoother", "predictive-coding"])
def test_estimate_accepts_a_log_without_reference(explored, tmp_path, reading, method) -> None:
    save(learn_body([_read(explored, 0, reading)], Settings(), {}).model, tmp_path / "body.npz")
    features = replace(_read(explored, 0, reading, 0.01, 12.0), reference=None)
    coding = METHODS[method].encoder_model
    found = estimate_from_features(
        *convert_readings_to_angles(
            features, load_body(tmp_path / "body.npz"), EstimationSettings(method=method), coding
        )
    )
    error = found.joints.values - motion(found.joints.t, 0)
    late = found.joints.t > 2.0
    if method != "predictive-coding":  # whose static belief lags behind
        assert 0.7 < np.square(found.errors["encoders"].values[200:]).mean() < 1.3
    assert np.sqrt(np.square(error[late]).mean()) < (
        0.03 if method == "predictive-coding" else 0.006
    )


def test_squares_about_zero_are_ambiguous_and_the_start_decides(explored) -> None:
    body = learn_body([_read(explored, 0, np.square)], Settings(), {}).model
    at, t = np.array([0.5, 0.4, 0.6]), np.arange(0.0, 12.0, 0.02)
    still = explored(0, 0.0, 12.0).features
    noise = np.random.default_rng(1).normal(0.0, 0.01, (len(t), 3))
    joints = replace(
        still.joints,
        t=t,
        values=at**2 + noise,
        names=body.joints,
        source_ns=(t * 1e9).astype(np.int64),
    )
    features = replace(still, joints=joints, tracks={})
    for method in ("filter", "smoother", "predictive-coding"):
        with pytest.raises(
            UsageError, match="turn or flatten over the explored angles; type: --method predictive"
        ):
            convert_readings_to_angles(
                features, body, EstimationSettings(method=method), METHODS[method].encoder_model
            )
    for sign in (1.0, -1.0):
        start = (sign * 0.3, 0.3, 0.4)
        asked = EstimationSettings(method="predictive-coding", senses=("encoders",), start=start)
        found = estimate_from_features(
            *convert_readings_to_angles(features, body, asked, coding=True)
        )
        assert np.abs(found.joints.values[-50:].mean(axis=0) - at * [sign, 1, 1]).max() < 0.02
        assert 0.5 < np.square(found.errors["encoders"].values[-300:]).mean() < 1.5


def test_readings_become_angles_by_name_and_extrapolate_linearly(explored) -> None:
    body = learn_body([_read(explored, 0, _bent)], Settings(), {}).model
    low, high = (
        body.senses["effector"].samples.min(axis=0),
        body.senses["effector"].samples.max(axis=0),
    )
    x = np.linspace(low - 0.02, high + 0.02, 400)
    joints = _read(explored, 0, _bent).joints
    wide = np.column_stack([x[:, [2, 0, 1]], np.full(400, 7.0)])
    there = replace(
        joints, t=np.arange(400.0), values=wide, names=("elbow", "pan", "lift", "wrist")
    )
    there.values[:, :3] = body.senses["encoders"].predict(x)[0][:, [2, 0, 1]]
    angled, plain, _ = convert_readings_to_angles(
        replace(explored(0, 0.0).features, joints=there), body, EstimationSettings()
    )
    assert np.abs(angled.joints.values[:, [1, 2, 0]] - x).max() < 1e-3
    inside = ((x > low) & (x < high)).all(axis=1)
    assert np.abs(angled.joints.values[inside][:, [1, 2, 0]] - x[inside]).max() < 1e-6
    assert (angled.joints.values[:, 3] == 7.0).all() and set(plain.senses) == {"effector"}


def test_update_without_reference_uses_the_bodys_encoder_function(explored) -> None:
    once = learn_body([_read(explored, 0, _square)], Settings(), {}).model
    more = replace(_read(explored, 0, _square, duration=10.0), reference=None)
    again = learn_body([more], Settings(), {}, once).model
    x = explored(0, 0.0, 20.0).angles
    assert again.senses["encoders"] is once.senses["encoders"]
    error = again.senses["effector"].predict(x)[0] - explored(0, 0.0, 20.0).pixels
    assert np.sqrt(np.mean(error**2)) < 0.25


def test_missing_encoders_and_readings_are_named(explored) -> None:
    features = _read(explored, 0, np.square)
    short = replace(features.joints, t=features.joints.t[:50], values=features.joints.values[:50])
    with pytest.raises(EvidenceError, match="pan: 50 readings during the reference, at least 200"):
        learn_body([replace(features, joints=short)], Settings(), {})
    others = replace(features.joints, names=("a", *JOINTS[1:]))
    with pytest.raises(
        ConfigError, match="its joint 'pan' has no encoder; possible: a, lift, elbow, wrist"
    ):
        learn_body([replace(features, joints=others)], Settings(), {})

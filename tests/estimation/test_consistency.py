"""Warnings from a log against its estimate: noise unlike the assumed, images that nothing explains."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.body import learn_body
from bodylog.estimation import estimate_from_features
from bodylog.settings import EstimationSettings, Settings
from tests.seeds import seeds

NOT_FORETOLD = "standard deviations from what was expected"


def doubted(found):
    return [f.text for f in found.findings if f.severity == "warning" and NOT_FORETOLD in f.text]


@pytest.mark.parametrize("method", ["filter", "smoother", "ekf"])
@pytest.mark.parametrize("seed", range(2))
def test_warnings_are_absent_for_a_sound_estimate(world, method, seed):
    drawn = world(seed, duration=10.0, hidden=(6.0, 8.0), blunder=0.02)
    assert not doubted(
        estimate_from_features(drawn.features, drawn.body, EstimationSettings(method=method))
    )


@pytest.mark.parametrize("method", ["filter", "smoother", "ekf"])
def test_warning_of_unexpected_noise_suggests_a_command(world, method):
    drawn = world(3, duration=5.0)
    quiet = replace(drawn.body.noise, encoder=tuple(v / 30.0 for v in drawn.body.noise.encoder))
    found = estimate_from_features(
        drawn.features,
        replace(drawn.body, noise=quiet),
        EstimationSettings(method=method, precision="model"),
    )
    (text,) = [text for text in doubted(found) if text.startswith("encoders: ")]
    assert text.endswith("type --precision auto")


def test_warning_of_an_offset_with_bias_off(world):
    drawn = world(4, duration=12.0, encoder_std=0.005)
    joints = drawn.features.joints
    values = joints.values + np.outer(
        np.clip((joints.t - 4.0) * 0.03, 0.0, None), np.arange(3) == 0
    )
    features = replace(drawn.features, joints=replace(joints, values=values))
    (text,) = doubted(estimate_from_features(features, drawn.body, EstimationSettings(bias="off")))
    assert text.startswith("effector: ") and text.endswith("type --bias auto")
    assert not doubted(estimate_from_features(features, drawn.body, EstimationSettings()))
    coding = doubted(
        estimate_from_features(features, drawn.body, EstimationSettings(method="predictive-coding"))
    )
    assert any(
        text.startswith("effector: ") and text.endswith("type --method filter") for text in coding
    )


def test_warning_of_two_publishers_on_one_topic(world):
    drawn = world(5, duration=5.0)
    joints = drawn.features.joints
    values = np.where(np.arange(len(joints.t))[:, None] % 2, 0.5, joints.values)
    features = replace(drawn.features, joints=replace(joints, values=values))
    texts = [
        f.text for f in estimate_from_features(features, drawn.body, EstimationSettings()).findings
    ]
    assert any(
        f"{joints.names[0]} has noise of" in text and "do two nodes publish" in text
        for text in texts
    )
    assert not any(
        "scatters" in f.text
        for f in estimate_from_features(drawn.features, drawn.body, EstimationSettings()).findings
    )


@pytest.mark.parametrize("seed", seeds(1, 2))
def test_a_joint_that_is_not_learned_and_stands_elsewhere_is_named_where_images_do_not_fit(world, seed):
    """The body's images are right for where it stood then; an encoder that is off was named in its place."""
    drawn = world(seed, duration=12.0, encoder_std=0.005)

    def hold_wrist(features, angle):
        joints = features.joints
        held = np.full((len(joints.t), 1), angle)
        values = np.concatenate([joints.values, held], axis=1)
        return replace(features, joints=replace(joints, names=(*joints.names, "wrist"), values=values))

    explored = learn_body([hold_wrist(drawn.features, 0.3)], Settings(), {}).model
    assert explored.provenance["held"] == {"wrist": [0.3, 0.3]}
    track = drawn.features.tracks["effector"]
    rng = np.random.default_rng(seed)
    far = 6.0 * rng.choice([-1.0, 1.0], track.values.shape)
    displaced = replace(drawn.features, tracks={"effector": replace(track, values=track.values + far)})
    settings = EstimationSettings(precision="model")
    for angle, named in ((0.33, True), (0.305, False)):
        found = estimate_from_features(hold_wrist(displaced, angle), explored, settings)
        (text,) = (one for one in doubted(found) if one.startswith("effector: "))
        assert ("wrist stands at 0.33 rad, and not at 0.3 as while" in text) == named
    assert not doubted(estimate_from_features(hold_wrist(drawn.features, 0.33), explored, EstimationSettings()))

"""Warnings from a log against its estimate: noise unlike the assumed, images that nothing explains."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.estimation import estimate
from bodylog.settings import Estimation

NOT_FORETOLD = "standard deviations from what was expected"


def doubted(found):
    return [f.text for f in found.findings if f.severity == "warning" and NOT_FORETOLD in f.text]


@pytest.mark.parametrize("method", ["laplace", "smoother", "ekf"])
@pytest.mark.parametrize("seed", range(2))
def test_a_sound_estimate_gives_no_warning(world, method, seed):
    drawn = world(seed, duration=10.0, hidden=(6.0, 8.0), blunder=0.02)
    assert not doubted(estimate(drawn.features, drawn.body, Estimation(method=method)))


@pytest.mark.parametrize("method", ["laplace", "smoother", "ekf"])
def test_noise_unlike_the_bodys_gives_a_warning_and_what_to_type(world, method):
    drawn = world(3, duration=5.0)
    quiet = replace(drawn.body.noise, encoder=tuple(v / 30.0 for v in drawn.body.noise.encoder))
    found = estimate(drawn.features, replace(drawn.body, noise=quiet), Estimation(method=method, precision="model"))
    (text,) = [text for text in doubted(found) if text.startswith("encoders: ")]
    assert text.endswith("type --precision auto")


def test_an_offset_with_bias_off_gives_a_warning(world):
    drawn = world(4, duration=12.0, encoder_std=0.005)
    joints = drawn.features.joints
    values = joints.values + np.outer(np.clip((joints.t - 4.0) * 0.03, 0.0, None), np.arange(3) == 0)
    features = replace(drawn.features, joints=replace(joints, values=values))
    (text,) = doubted(estimate(features, drawn.body, Estimation(bias="off")))
    assert text.startswith("effector: ") and text.endswith("type --bias auto")
    assert not doubted(estimate(features, drawn.body, Estimation()))
    coding = doubted(estimate(features, drawn.body, Estimation(method="predictive-coding")))
    assert any(text.startswith("effector: ") and text.endswith("type --method laplace") for text in coding)


def test_two_publishers_on_one_topic_give_a_warning(world):
    drawn = world(5, duration=5.0)
    joints = drawn.features.joints
    values = np.where(np.arange(len(joints.t))[:, None] % 2, 0.5, joints.values)
    features = replace(drawn.features, joints=replace(joints, values=values))
    texts = [f.text for f in estimate(features, drawn.body, Estimation()).findings]
    assert any(f"{joints.names[0]} has noise of" in text and "do two nodes publish" in text for text in texts)
    assert not any("scatters" in f.text for f in estimate(drawn.features, drawn.body, Estimation()).findings)

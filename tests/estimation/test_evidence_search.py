"""White acceleration or white jerk, as the encoders' evidence prefers; an order with typed variances is 2."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.estimation.faults.threshold import EVIDENCE_THRESHOLD_NATS
from bodylog.settings import EstimationSettings
from tests.estimation.conftest import WHITE_MOTIONS, World, draw
from tests.estimation.resting import Drawn, drawn
from tests.seeds import seeds


def shaken(seed: int) -> World:
    """Joints of white acceleration, 0.5 rad²/s³, read 100 times a second."""
    world, rng = draw(seed, encoder_hz=100.0), np.random.default_rng(seed)
    joints = world.features.joints
    acceleration = rng.normal(0.0, np.sqrt(0.5 / 0.01), joints.values.shape)
    x = np.cumsum(np.cumsum(acceleration, axis=0) * 0.01, axis=0) * 0.01
    joints = replace(joints, values=x + rng.normal(0.0, 0.003, x.shape))
    return replace(world, features=replace(world.features, joints=joints, tracks={}))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("world", "order"), [(lambda seed: draw(seed, encoder_hz=100.0), 3), (shaken, 2)])
def test_motion_order_is_chosen_by_evidence_and_listed(world, order, seed):
    made = world(seed)
    settings = estimate_from_features(made.features, made.body, EstimationSettings(senses=("encoders",))).settings
    (jerk,) = [one for one in settings["hypotheses"] if one["name"] == "white jerk"]
    assert settings["motion"] == WHITE_MOTIONS[order] and jerk["chosen"] == (order == 3)
    assert (jerk["nats"] > 0.0) == jerk["chosen"] and (jerk["about"], jerk["threshold"]) == ("joints", 0.0)


def test_typed_process_is_white_acceleration():
    world = draw(0, encoder_hz=100.0)
    found = estimate_from_features(world.features, world.body, EstimationSettings(process=0.3))
    assert found.settings["motion"] == WHITE_MOTIONS[2] and found.settings["process"] == [0.3] * 3
    assert "white jerk" not in [one["name"] for one in found.settings.get("hypotheses", ())]


STICKING = Drawn("slow", step=1.5e-3, encoder_hz=20.0, slip=0.006)
QUANTISED = Drawn("slow", step=0.01, gaps=2)
RESTING = Drawn("rest", noise=0.005, gaps=3)


@pytest.mark.parametrize("seed", seeds(1, 3))
@pytest.mark.parametrize("how", [STICKING, QUANTISED, RESTING], ids=str)
def test_joints_that_stick_or_rest_have_white_acceleration(how, seed):
    """A quantised encoder's least variance is no evidence for white jerk, nor are short gaps of a joint at rest."""
    world = drawn(100 + seed, how)
    settings = estimate_from_features(world.features, world.body, EstimationSettings()).settings
    (jerk,) = [one for one in settings["hypotheses"] if one["name"] == "white jerk"]
    assert settings["motion"] == WHITE_MOTIONS[2] and jerk["nats"] < jerk["threshold"]
    assert jerk["threshold"] == (-3 * EVIDENCE_THRESHOLD_NATS if how.gaps else 0.0)

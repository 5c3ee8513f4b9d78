"""Readings that cannot be the angles of the body: another unit, a whole turn off, or another range."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from bodylog.errors import ModelError
from bodylog.estimation import estimate_from_features
from bodylog.settings import EstimationSettings
from bodylog.types import Array
from tests.estimation.conftest import Arm, motion


@dataclass(frozen=True)
class Learned(Arm):
    """An arm that keeps the angles at which it was explored."""

    samples: Array = field(default_factory=lambda: motion(np.arange(0.0, 40.0, 0.1), np.random.default_rng(0)))


@pytest.fixture
def drawn(world):
    return world(1, duration=8.0, model=Learned())


def read(drawn, change):
    joints = drawn.features.joints
    return replace(drawn.features, joints=replace(joints, values=change(joints.values)))


def range_texts(drawn, change):
    found = estimate_from_features(read(drawn, change), drawn.body, EstimationSettings())
    return [f.text for f in found.findings if f.severity == "warning" and f.text.startswith("joints: ")]


def test_explored_angles_give_no_warning(drawn):
    assert not range_texts(drawn, lambda x: x)
    assert not range_texts(drawn, lambda x: x + 0.3)


@pytest.mark.parametrize("method", ["filter", "smoother", "kalman", "predictive-coding"])
@pytest.mark.parametrize("senses", [None, ("encoders",), ("elbow",)])
def test_degrees_are_refused_with_what_to_type(drawn, method, senses):
    with pytest.raises(ModelError, match=r'these are degrees; type \[body\] unit = "deg" in robot.toml'):
        estimate_from_features(read(drawn, np.rad2deg), drawn.body, EstimationSettings(method=method, senses=senses))


def test_degrees_are_refused_where_encoders_only_give_the_start(drawn):
    with pytest.raises(ModelError, match="these are degrees"):
        estimate_from_features(read(drawn, np.rad2deg), drawn.body, EstimationSettings(senses=("vision",)))


def test_degrees_are_not_inferred_near_zero_in_another_range(world):
    around = Learned(samples=motion(np.arange(0.0, 40.0, 0.1), np.random.default_rng(0)) * [0.1, 1.0, 1.0])
    drawn = world(1, duration=8.0, model=around)
    (text,) = range_texts(drawn, lambda x: x)
    assert "beyond that" in text


def test_range_warning_names_a_joint_one_turn_off(drawn):
    (text,) = range_texts(drawn, lambda x: x + np.array([0.0, 2.0 * np.pi, 0.0]))
    assert text.startswith(f"joints: {drawn.features.joints.names[1]} reads ") and "+1 whole turns off" in text


@pytest.mark.soak
def test_range_warning_names_a_joint_outside_its_explored_range(drawn):
    (text,) = range_texts(drawn, lambda x: x + np.array([0.0, 0.0, 3.0]))
    assert text.startswith(f"joints: {drawn.features.joints.names[2]} reads ") and "beyond that" in text


def test_range_warning_is_absent_for_an_encoder_without_readings(drawn):
    def silenced(x):
        return np.where([False, False, True] & (np.arange(len(x)) > 0)[:, None], np.nan, x)

    assert not range_texts(drawn, silenced)

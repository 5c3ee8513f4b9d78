"""Bounds on what no score says: faults, delays, shares of what was used."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.errors import BoundError, UsageError
from bodylog.estimation import estimate_from_features
from bodylog.evaluation.bounds import check_bounds, parse_bound
from bodylog.evaluation.figures import list_figures
from bodylog.settings import EstimationSettings
from bodylog.types import Fault, FaultKind
from tests.estimation.conftest import draw


@pytest.fixture(scope="module")
def sound():
    drawn = draw(0, duration=8.0)
    return estimate_from_features(drawn.features, drawn.body, EstimationSettings())


def judged(found, *bounds):
    check_bounds({"run.mcap": list_figures(found)}, [parse_bound(text) for text in bounds])


OFFSET = Fault("encoders", "elbow", FaultKind.DRIFTING, 0.1, -0.087, "rad")
FROZEN = Fault("encoders", "pan", FaultKind.FROZEN, 0.1, 0.0, "rad")
OPEN = Fault("encoders", "lift or elbow", FaultKind.DRIFTING, 0.1, float("nan"), "rad")


@pytest.mark.parametrize("bound", ["faults>0", "fault/*>0", "fault/encoder_offset/elbow>0.05", "delay/camera>0.05"])
def test_bounds_hold_for_a_sound_log(sound, bound):
    judged(sound, bound, "used_share/effector<0.9", "delay/*>0")


@pytest.mark.parametrize(
    ("faults", "bound", "text"),
    [
        ((OFFSET,), "faults>0", "faults is 1"),
        ((OFFSET,), "fault/encoder_offset/elbow>0.05", "fault/encoder_offset/elbow is 0.087"),
        ((OFFSET,), "fault/drifting/el*>0.05", "fault/drifting/elbow is 0.087"),
        ((FROZEN,), "fault/frozen/pan>0", "fault/frozen/pan is 1"),
        ((OPEN,), "fault/encoder_offset/lift>0.05", "fault/encoder_offset/lift is nan"),
        ((OPEN,), "fault/*/elbow>0.05", "fault/encoder_offset/elbow is nan"),
    ],
)
def test_bounds_detect_a_fault_without_truth(sound, faults, bound, text):
    with pytest.raises(BoundError, match=text):
        judged(replace(sound, faults=faults), bound)


def test_bounds_detect_a_late_camera(sound):
    with pytest.raises(BoundError, match=r"delay/camera is 0\.06"):
        judged(replace(sound, settings={**sound.settings, "delay": {"camera": 0.06}}), "delay/camera>0.05")


def test_bounds_fail_for_unobservable_figures():
    drawn = draw(0, duration=8.0)
    joints = drawn.features.joints
    off = replace(joints, values=joints.values + 0.087 * (np.array(joints.names) == "elbow"))
    blind = estimate_from_features(replace(drawn.features, joints=off), drawn.body, EstimationSettings(senses=("encoders",)))
    with pytest.raises(BoundError, match="fault/encoder_offset/elbow is nan"):
        judged(blind, "fault/encoder_offset/elbow>0.05")
    judged(blind, "fault/frozen/elbow>0", "faults>0")


@pytest.mark.parametrize("name", ["fault/encoder_offset/elbov", "fault/encoder_offset/elbow_joint"])
def test_bounds_of_an_unknown_joint_suggest_similar_names(sound, name):
    with pytest.raises(UsageError, match=r"possible: .*fault/encoder_offset/elbow"):
        judged(sound, f"{name}>0.05")

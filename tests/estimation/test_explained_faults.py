"""Faults on an arm with the errors of real hardware: named alone, as on a sound arm, or not.

The arm, its errors and its motions are drawn; the body is learned from 40 s with the same errors.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.settings import EstimationSettings
from bodylog.types import FaultKind
from tests.estimation import mechanisms
from tests.estimation.mechanisms import REALISTIC, SOUND, Fault, errors_and_nees, links_of

LOGS = 10
SEEDS = range(7700, 7700 + LOGS)
SINCE = 8.0
"""s: from when something is wrong."""
LATE_S = 0.04
MOVED_PX = 5.0
ARMS = {"sound": SOUND, "all errors, mild": REALISTIC}
LEAST = 9
"""Of LOGS: 55 of 60 and more."""


def freeze_encoder(features):
    """Pan reads one value from SINCE to 4 s later."""
    joints = features.joints
    values = joints.values.copy()
    frozen = (joints.t >= SINCE) & (joints.t < SINCE + 4.0)
    values[frozen, 0] = values[np.flatnonzero(frozen)[0], 0]
    return replace(features, joints=replace(joints, values=values))


def make_late(features):
    """Images that are stamped LATE_S late."""
    track = features.tracks["effector"]
    return replace(features, tracks={"effector": replace(track, t=track.t + LATE_S)})


def move_camera(features):
    """Images that are MOVED_PX off to one side from SINCE on."""
    track = features.tracks["effector"]
    off = track.values + np.array([MOVED_PX, 0.0]) * (track.t >= SINCE)[:, None]
    return replace(features, tracks={"effector": replace(track, values=off)})


def keep_features(features):
    """The features as they are."""
    return features


KINDS = {
    "lift, off by 2°": (Fault(1, offset=float(np.deg2rad(2.0))), keep_features, ("lift",)),
    "pan, drifting by 0.02 rad/s": (Fault(0, drift=0.02), keep_features, ("pan",)),
    "elbow, drifting by 0.005 rad/s": (Fault(2, drift=0.005), keep_features, ("elbow",)),
    "pan, frozen for 4 s": (Fault(), freeze_encoder, ("pan",)),
    "camera, 40 ms late": (Fault(), make_late, ()),
    "camera, moved by 5 px": (Fault(), move_camera, ("camera",)),
    "none": (Fault(), keep_features, ()),
}


@cache
def estimate_log(arm, name, seed):
    """The estimate of a log with a fault."""
    fault, spoil, _ = KINDS[name]
    features = spoil(mechanisms.replayed(seed, ARMS[arm], fault, reaches=seed % 2 == 1))
    return estimate_from_features(features, mechanisms.fitted(ARMS[arm]), EstimationSettings())


def judge_log(arm, name, seed):
    """Whether a log's fault, and nothing else, is found."""
    _, spoil, wrong = KINDS[name]
    found = estimate_log(arm, name, seed)
    late = found.settings.get("delay", {})
    if spoil is make_late:
        std = found.settings.get("delay_std", {}).get("camera", 0.0)
        near = abs(late.get("camera", 0.0) - LATE_S) <= max(3e-3, 2.0 * std)
        return near and not found.faults
    named = tuple("camera" if one.kind == FaultKind.DISPLACED else one.name for one in found.faults)
    return named == wrong and not late


@pytest.mark.soak
@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("name", KINDS)
def test_faults_of_real_arms_are_found_alone_as_on_sound_ones(arm, name):
    assert sum(judge_log(arm, name, seed) for seed in SEEDS) >= LEAST


@pytest.mark.soak
@pytest.mark.parametrize("name", KINDS)
def test_error_bars_beside_faults_of_real_arms_hold(name):
    arm = "all errors, mild"
    nees = [
        errors_and_nees(
            estimate_log(arm, name, seed),
            links_of(seed, ARMS[arm], KINDS[name][0], reaches=seed % 2 == 1),
        )[1]
        for seed in SEEDS
    ]
    assert sum(one < 2.0 for one in nees) >= LEAST

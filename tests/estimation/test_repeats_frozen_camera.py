"""A frozen camera: named and its images removed where two encoders show that the arm moved."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.settings import EstimationSettings


def freeze(drawn, begin, end=np.inf):
    track = drawn.features.tracks["effector"]
    values = track.values.copy()
    rows = (track.t >= begin) & (track.t < end)
    values[rows] = values[np.flatnonzero(rows)[0]]
    return replace(drawn.features, tracks={"effector": replace(track, values=values)})


@pytest.mark.parametrize("method", ["filter", "smoother", "ekf", "predictive-coding"])
@pytest.mark.parametrize("seed", range(2))
def test_frozen_camera_is_named_and_its_images_removed(world, method, seed):
    drawn = world(seed, duration=12.0, camera_hz=20.0)
    found = estimate_from_features(
        freeze(drawn, 6.0), drawn.body, EstimationSettings(method=method)
    )
    ((fault),) = found.faults
    assert (fault.sense, fault.name, fault.kind, fault.unit) == (
        "vision",
        "effector",
        "frozen",
        "px",
    )
    assert 6.0 <= fault.since < 6.2 and fault.size > 5.0
    health = found.used["effector"]
    assert health.rejected["frozen"] == 119 and health.used == 121
    if method != "predictive-coding":
        error = found.joints.values - drawn.truth.values
        assert np.mean(error**2 / np.einsum("nii->ni", found.cov)) < 1.6


def test_frozen_camera_may_recover(world):
    drawn = world(2, duration=12.0, camera_hz=20.0)
    found = estimate_from_features(freeze(drawn, 4.0, 7.0), drawn.body, EstimationSettings())
    assert [(fault.sense, fault.kind) for fault in found.faults] == [("vision", "frozen")]
    assert found.used["effector"].rejected["frozen"] == 59


def test_images_of_an_arm_at_rest_may_repeat(world):
    drawn = world(3, duration=12.0, camera_hz=20.0, speed=0.0)
    found = estimate_from_features(freeze(drawn, 0.0), drawn.body, EstimationSettings())
    assert not found.faults and "frozen" not in found.used["effector"].rejected


def test_frozen_camera_ignores_one_drifting_encoder_at_rest(world):
    drawn = world(3, duration=14.0, camera_hz=20.0, speed=0.0, encoder_std=0.005, pixel_std=0.1)
    features = freeze(drawn, 0.0)
    joints = features.joints
    values = joints.values + np.outer(
        np.clip((joints.t - 5.0) * 0.03, 0.0, None), np.arange(3) == 0
    )
    found = estimate_from_features(
        replace(features, joints=replace(joints, values=values)), drawn.body, EstimationSettings()
    )
    assert [(fault.sense, fault.name) for fault in found.faults] == [("encoders", joints.names[0])]


def test_frozen_camera_is_named_with_encoders_on_separate_topics(world):
    drawn = world(0, duration=12.0, camera_hz=20.0)
    features = freeze(drawn, 6.0)
    values = features.joints.values.copy()
    values[::2, 0], values[1::2, 1:] = np.nan, np.nan
    found = estimate_from_features(
        replace(features, joints=replace(features.joints, values=values)),
        drawn.body,
        EstimationSettings(),
    )
    assert [(fault.sense, fault.name, fault.kind) for fault in found.faults] == [
        ("vision", "effector", "frozen")
    ]


def test_frozen_camera_ignores_two_jumping_encoders_at_rest(world):
    """Encoders are screened for their own faults before they judge a camera."""
    drawn = world(3, duration=14.0, camera_hz=20.0, speed=0.0, encoder_std=0.002, pixel_std=0.1)
    features = freeze(drawn, 0.0)
    joints = features.joints
    values = joints.values + 0.15 * np.outer(joints.t >= 6.0, np.arange(3) < 2)
    found = estimate_from_features(
        replace(features, joints=replace(joints, values=values)), drawn.body, EstimationSettings()
    )
    assert {(fault.sense, fault.kind) for fault in found.faults} == {("encoders", "jumping")}
    assert {fault.name for fault in found.faults} == set(joints.names[:2])

"""Each reading as all others of a smoothed log predict it, and the outliers that this shows."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.settings import EstimationSettings

MODEL = EstimationSettings(method="smoother", precision="model", bias="off")


def spoilt(features, frame=None, reading=None, add=np.nan):
    """The features with `add` on one frame (row) of the effector, or one reading (row, joint) of the encoders."""
    track, joints = features.tracks["effector"], features.joints
    places, angles = track.values.copy(), joints.values.copy()
    if frame is not None:
        places[frame] += add
    if reading is not None:
        angles[reading] += add
    return replace(features, joints=replace(joints, values=angles), tracks={"effector": replace(track, values=places)})


@pytest.mark.parametrize("seed", range(2))
def test_prediction_of_a_reading_is_that_of_the_log_without_it(world, linear_model, seed):
    drawn = world(seed, duration=6.0, model=linear_model)
    whole, joints = estimate_from_features(drawn.features, drawn.body, MODEL), drawn.features.joints
    names = list(joints.names)
    for frame in (20, 61):
        less = estimate_from_features(spoilt(drawn.features, frame=frame), drawn.body, MODEL)
        ours, expected = (found.predicted["effector"].values[frame] for found in (whole, less))
        np.testing.assert_allclose(ours, expected, atol=1e-6, rtol=0)
        np.testing.assert_allclose(
            whole.predicted_cov["effector"][frame], less.predicted_cov["effector"][frame], rtol=1e-6
        )
    for row, joint in ((100, 1), (201, 0)):
        less = estimate_from_features(spoilt(drawn.features, reading=(row, joint)), drawn.body, MODEL)
        own = drawn.body.joints.index(names[joint])
        error = joints.values[row, joint] - less.joints.values[row, own]
        expected = error / np.sqrt(less.cov[row, own, own] + drawn.body.noise.encoder[own])
        assert whole.errors["encoders"].values[row, own] == pytest.approx(expected, abs=1e-6)


def test_errors_of_a_smoother_have_variance_one(world):
    squares = {"encoders": [], "effector": []}
    for seed in range(4):
        drawn = world(seed, duration=10.0)
        found = estimate_from_features(drawn.features, drawn.body, EstimationSettings(method="smoother"))
        for name, kept in squares.items():
            kept.append(np.nanmean(found.errors[name].values ** 2))
    assert all(0.9 < np.mean(kept) < 1.1 for kept in squares.values())


@pytest.mark.parametrize("sense", ["frame", "reading"])
@pytest.mark.parametrize("seed", [0, 3])
def test_evidence_of_the_whole_log_falls_with_an_outliers_distance(world, sense, seed):
    drawn, costs = world(seed, duration=6.0), []
    for far in (0.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 30.0, 100.0):
        one = {"frame": 61, "add": far * np.array([1.2, -0.6])} if sense == "frame" else {"reading": (150, 1)}
        features = spoilt(drawn.features, **({"add": far * 0.022} | one))
        costs.append(estimate_from_features(features, drawn.body, MODEL).free_energy.sum())
    assert (np.diff(costs[1:]) > 0.0).all() and 9.0 < costs[-1] - costs[0] < 20.0


@pytest.mark.parametrize("seed", range(4))
def test_one_image_that_the_filter_believes_does_not_move_the_smoothed_path(world, seed):
    drawn = world(seed, duration=6.0)
    clean = estimate_from_features(drawn.features, drawn.body, MODEL)
    std = np.sqrt(np.einsum("nii->ni", clean.cov))
    for far in (4.0, 6.0):
        features = spoilt(drawn.features, frame=61, add=far * np.array([1.2, -0.6]))
        moved = estimate_from_features(features, drawn.body, MODEL).joints.values - clean.joints.values
        assert np.abs(moved / std).max() < 1.0

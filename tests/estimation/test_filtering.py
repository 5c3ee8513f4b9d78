"""The filter against a textbook one, and against mistakes."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.evaluation.scores import score_angles
from bodylog.settings import EstimationSettings
from bodylog.types import Series
from tests.seeds import seeds

MODEL = EstimationSettings(precision="model", bias="off")


def rmse(found, world):
    return {score.name: score.value for score in score_angles(found, world.truth, world.features.joints)}


@pytest.mark.parametrize("seed", seeds(1, 3))
@pytest.mark.parametrize(("encoder_hz", "duration"), [(50.0, 6.0), (400.0, 6.0), (400.0, 16.0)])
def test_filter_of_a_linear_body_is_the_kalman_filter(world, reference, linear_model, seed, encoder_hz, duration):
    drawn = world(seed, duration=duration, encoder_hz=encoder_hz, model=linear_model, hidden=(2.0, 3.0))
    found = estimate_from_features(drawn.features, drawn.body, replace(MODEL, rate=None))
    expected = reference(drawn, np.full(3, 0.3), np.full(3, 0.02**2), 0.4**2)
    at = np.searchsorted(expected.t, found.joints.t)
    grid = expected.t[at] == found.joints.t
    assert grid.all()
    np.testing.assert_allclose(found.joints.values[grid], expected.mean[at[grid], :3], atol=1e-9, rtol=0)
    np.testing.assert_allclose(found.rate.values[grid], expected.mean[at[grid], 3:], atol=1e-8, rtol=0)
    np.testing.assert_allclose(found.cov[grid], expected.cov[at[grid], :3, :3], atol=1e-9, rtol=0)
    assert found.free_energy.sum() == pytest.approx(expected.nats[: at[-1] + 1].sum(), abs=1e-6)


@pytest.mark.parametrize(("encoder_hz", "duration"), [(50.0, 6.0), (400.0, 16.0)])
def test_filter_under_white_jerk_is_the_kalman_filter(
    world, reference, linear_model, white_jerk, encoder_hz, duration
):  # fmt: skip
    drawn = world(1, duration=duration, encoder_hz=encoder_hz, model=linear_model, hidden=(2.0, 3.0))
    found = estimate_from_features(drawn.features, drawn.body, replace(MODEL, rate=None))
    expected = reference(drawn, white_jerk, np.full(3, 0.02**2), 0.4**2, order=3)
    at = np.searchsorted(expected.t, found.joints.t)
    np.testing.assert_allclose(found.joints.values, expected.mean[at, :3], atol=1e-9, rtol=0)
    np.testing.assert_allclose(found.rate.values, expected.mean[at, 3:6], atol=1e-8, rtol=0)
    np.testing.assert_allclose(found.cov, expected.cov[at, :3, :3], atol=1e-9, rtol=0)
    assert found.free_energy.sum() == pytest.approx(expected.nats[: at[-1] + 1].sum(), abs=1e-6)


def test_fast_encoders_are_all_used_but_written_at_100_hz(world, linear_model):
    drawn = world(0, duration=3.0, encoder_hz=500.0, model=linear_model)
    found = estimate_from_features(drawn.features, drawn.body, MODEL)
    np.testing.assert_allclose(np.diff(found.joints.t), 0.01)
    assert found.used["encoders"].used == 1500
    earlier = drawn.features.joints.t[:, None] <= found.joints.t + 1e-12
    assert (found.joints.source_ns >= drawn.features.joints.source_ns[earlier.sum(axis=0) - 1]).all()


@pytest.mark.parametrize("rate", [10.0, 200.0])
def test_estimate_rate_is_the_configured_one(world, rate):
    drawn = world(0, duration=3.0)
    found = estimate_from_features(drawn.features, drawn.body, replace(MODEL, rate=rate))
    np.testing.assert_allclose(np.diff(found.joints.t), 1 / rate)


def test_order_of_simultaneous_senses_does_not_matter(world):
    drawn = world(1, duration=5.0, camera_hz=12.5, blunder=0.1)
    track = drawn.features.tracks["effector"]
    track = replace(track, t=drawn.features.joints.t[::4][: len(track.t)])
    other = replace(track, values=track.values + np.random.default_rng(0).normal(0, 1.0, track.values.shape))
    body = replace(drawn.body, senses={name: drawn.body.senses["effector"] for name in ("effector", "other")})
    pair = {"effector": track, "other": other}
    one = estimate_from_features(replace(drawn.features, tracks=pair), body, MODEL)
    two = estimate_from_features(replace(drawn.features, tracks=dict(reversed(pair.items()))), body, MODEL)
    np.testing.assert_allclose(one.joints.values, two.joints.values, atol=1e-9, rtol=0)
    np.testing.assert_allclose(one.cov, two.cov, atol=1e-12, rtol=0)


def test_filter_of_a_still_arm_has_noise_without_motion(world, white_acceleration):
    ratios, shares = [], []
    for seed in range(6):
        drawn = world(seed, speed=0.0)
        found = estimate_from_features(drawn.features, drawn.body, EstimationSettings(senses=("encoders",)))
        ratios.append([rmse(found, drawn)[f"nees/joint/{name}"] for name in drawn.body.joints])
        shares.append(found.settings["stated"])
    assert 0.85 < np.mean(ratios) < 1.2
    assert 0.75 <= np.mean(shares) < 0.85


def test_filter_rejects_a_mistaken_blob(world):
    worse = []
    for seed in range(4):
        clean, spoilt = (world(seed, duration=10.0, blunder=share) for share in (0.0, 0.06))
        found = [rmse(estimate_from_features(w.features, w.body, MODEL), w)["rmse/joint"] for w in (clean, spoilt)]
        worse.append(found[1] / found[0])
    assert np.mean(worse) < 1.1


def test_error_bars_are_true_and_the_gap_is_no_exception(world):
    nees, inside, hidden = [], [], []
    for seed in range(5):
        drawn = world(seed, duration=14.0, hidden=(6.0, 8.0), pixel_std=0.1)
        found = estimate_from_features(drawn.features, drawn.body, EstimationSettings())
        score = rmse(found, drawn)
        nees.append([score[f"nees/joint/{name}"] for name in drawn.body.joints])
        inside.append(score["coverage_2sigma/joint"])
        gap = (found.joints.t > 6.0) & (found.joints.t < 8.0)
        ratio = (found.joints.values - drawn.truth.values)[gap] ** 2 / np.einsum("nii->ni", found.cov[gap])
        hidden.append(ratio.mean())
    assert np.all((np.mean(nees, axis=0) > 0.85) & (np.mean(nees, axis=0) < 1.2))
    assert 93.0 < np.mean(inside) < 97.0
    assert 0.7 < np.mean(hidden) < 1.4


@pytest.mark.parametrize("method", ["filter", "smoother", "ekf"])
@pytest.mark.parametrize("sense", ["encoders", "image"])
def test_evidence_falls_with_an_outliers_distance(world, method, sense):
    drawn, costs = world(2, duration=6.0), []
    joints, track = drawn.features.joints, drawn.features.tracks["effector"]
    at = {"encoders": joints.t[150], "image": track.t[len(track.t) // 2]}[sense]
    for far in (0.0, 2.0, 5.0, 5.5, 7.0, 10.0, 18.0, 40.0, 200.0):
        angles, places = joints.values.copy(), track.values.copy()
        if sense == "encoders":
            angles[150, 1] += far * 0.02
        else:
            places[len(places) // 2] += far * np.array([2.0, -1.0])
        features = replace(
            drawn.features, joints=replace(joints, values=angles), tracks={"effector": replace(track, values=places)}
        )
        found = estimate_from_features(features, drawn.body, replace(MODEL, method=method))
        costs.append(found.free_energy[np.searchsorted(found.joints.t, at)])
    rises = np.diff(costs)
    assert (rises > 0.0).all() and rises[-1] < 1.0 and 10.0 < sum(rises) < 20.0


def test_vision_alone_replaces_a_silent_encoder(world):
    drawn = world(3)
    found = estimate_from_features(drawn.features, drawn.body, EstimationSettings(senses=("pan", "elbow", "vision")))
    assert rmse(found, drawn)["rmse/joint/lift"] < 0.01


def test_predictions_and_errors_are_standardised(world):
    drawn = world(2, hidden=(6.0, 8.0))
    found = estimate_from_features(drawn.features, drawn.body, EstimationSettings())
    track = drawn.features.tracks["effector"]
    assert found.predicted["effector"].t.tolist() == track.t.tolist()
    seen = np.isfinite(track.values).all(axis=1)
    np.testing.assert_allclose(
        found.errors["effector"].values,
        ((track.values - found.predicted["effector"].values) / found.predicted["effector"].std)[seen],
    )
    assert 0.6 < np.mean(found.errors["effector"].values ** 2) < 1.3
    assert 0.9 < np.nanmean(found.errors["encoders"].values ** 2) < 1.1


def test_extended_filter_is_close_but_different(world):
    drawn = world(0)
    iterated, once = (estimate_from_features(drawn.features, drawn.body, replace(MODEL, method=m)) for m in ("filter", "ekf"))
    apart = np.abs(iterated.joints.values - once.joints.values).max()
    assert 1e-8 < apart < 5e-3


@pytest.mark.parametrize("method", ["filter", "smoother"])
def test_same_input_same_bytes(world, method):
    drawn = world(0, duration=5.0)
    one, two = (estimate_from_features(drawn.features, drawn.body, EstimationSettings(method=method)) for _ in range(2))
    assert one.joints.values.tobytes() == two.joints.values.tobytes()
    assert one.cov.tobytes() == two.cov.tobytes()


def test_nan_and_backward_times_are_skipped_and_counted(world):
    drawn = world(0, duration=5.0)
    joints = drawn.features.joints
    values, t = joints.values.copy(), joints.t.copy()
    values[50:60] = np.nan
    values[70:80, 0] = np.nan
    t[100:110] = t[40:50]
    spoilt = Series(t, values, joints.names, joints.unit, joints.source_ns)
    found = estimate_from_features(replace(drawn.features, joints=spoilt), drawn.body, EstimationSettings())
    assert found.used["encoders"].rejected == {"time runs backwards": 10, "not a number": 10, "without elbow": 10}
    assert rmse(found, drawn)["rmse/joint"] < 0.01


@pytest.mark.parametrize("method", ["filter", "smoother"])
def test_filter_tolerates_far_too_small_encoder_noise(world, method):
    drawn = world(0, duration=6.0, pixel_std=0.07)
    body = replace(drawn.body, noise=replace(drawn.body.noise, encoder=(9e-6,) * 3, process=(0.06,) * 3))
    found = estimate_from_features(drawn.features, body, EstimationSettings(method=method, precision="model"))
    assert np.isfinite(found.joints.values).all()
    assert rmse(found, drawn)["rmse/joint"] < 0.05
    assert np.linalg.eigvalsh(found.cov).min() > 0

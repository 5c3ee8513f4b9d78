"""Still poses: each estimated from its own readings, with encoder noise and offsets from all poses together."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from bodylog import body
from bodylog.body_model import BodyModel
from bodylog.errors import UsageError
from bodylog.estimation import estimate_from_features
from bodylog.estimation.poses import (
    EncoderErrors,
    collect_pose_readings,
    compute_position_evidence,
    descend_poses,
)
from bodylog.settings import BodySettings, EstimationSettings, Settings
from bodylog.types import Features, Series

JOINTS = ("pan", "lift", "elbow")
POSES, PIXEL = 120, 0.3


def _places(q: np.ndarray, camera: float) -> np.ndarray:
    """Pixels (N,4) of the hand and of a point in front of it, seen by a pinhole camera turned by `camera` rad."""
    out = []
    for fore in (0.39, 0.2):
        pan, lift, elbow = q[:, 0] + camera, q[:, 1], q[:, 2]
        reach = 0.42 * np.cos(lift) + fore * np.cos(lift + elbow)
        depth = 1.6 - reach * np.cos(pan)
        height = 0.42 * np.sin(lift) + fore * np.sin(lift + elbow)
        out += [160 + 280 * reach * np.sin(pan) / depth, 120 - 280 * (height - 0.3) / depth]
    return np.column_stack(out)


def _poses(
    seed: int, noise: float = 0.0005, offset: tuple[float, ...] = (0, 0, 0), hidden: float = 0.0
):
    """Features of POSES drawn poses, and the true angles (N,3) rad."""
    draw = np.random.default_rng(seed)
    q = np.array([0.0, 0.3, 0.6]) + draw.uniform(-0.5, 0.5, (POSES, 3))
    t, ns = np.arange(POSES, dtype=float), np.arange(POSES) * 10**9
    joints = Series(t, q + draw.normal(0, noise, q.shape) + offset, JOINTS, "rad", ns)
    tracks = {}
    for camera, turn in {"": 0.0, "left/": 0.7}.items():
        seen = _places(q, turn) + draw.normal(0, PIXEL, (POSES, 4))
        for k, name in enumerate(("hand_marker", "wrist_marker")):
            places = np.where(draw.random((POSES, 1)) < hidden, np.nan, seen[:, 2 * k : 2 * k + 2])
            tracks[camera + name] = Series(t, places, ("u", "v"), "px", ns)
    return Features(joints, tracks, None, (), (), {}, poses=True), q


@pytest.fixture(scope="module")
def learned() -> BodyModel:
    """The body learned from poses alone."""
    found = body.learn_body([_poses(0)[0]], Settings(body=BodySettings(joints=JOINTS)), {})
    return found.model


def _nees(found, q):
    error = found.joints.values - q
    return float(
        np.einsum("pi,pij,pj->p", error, np.linalg.inv(found.cov), error).mean() / q.shape[1]
    )


def test_learn_from_poses_predicts_other_poses(learned):
    features, q = _poses(1)
    for name, sense in learned.senses.items():
        mean, _, var = sense.predict(q)
        error = features.tracks[name].values - mean
        assert np.sqrt(np.mean(error**2)) < 0.8
        assert 0.6 < np.mean(error**2 / (var + np.array(learned.noise.senses[name]))) < 1.6


@pytest.mark.parametrize("seed", range(2, 5))
def test_noisy_encoders_are_weighted_by_their_noise(learned, seed):
    features, q = _poses(seed, noise=0.05, hidden=0.2)
    found = estimate_from_features(features, learned, EstimationSettings())
    assert np.all(np.abs(np.log(np.sqrt(found.settings["encoder"]) / 0.05)) < 0.35)
    assert (
        np.sqrt(np.mean((found.joints.values - q) ** 2)) < 0.05 / 4 and 0.7 < _nees(found, q) < 1.5
    )
    assert found.faults == () and found.bias is None


def test_noise_is_learned_beside_an_encoder_that_was_never_read(learned):
    features, q = _poses(5, noise=0.05)
    values = np.where([False, True, False], np.nan, features.joints.values)
    found = estimate_from_features(
        replace(features, joints=replace(features.joints, values=values)),
        learned,
        EstimationSettings(),
    )
    assert np.all(np.abs(np.log(np.sqrt(found.settings["encoder"])[[0, 2]] / 0.05)) < 0.35)
    assert (
        np.sqrt(np.mean((found.joints.values - q) ** 2)) < 0.05 / 4 and 0.6 < _nees(found, q) < 1.5
    )


@pytest.mark.parametrize(("joint", "size"), [(0, 0.05), (1, -0.03), (2, 0.05)])
def test_offset_in_all_poses_is_named_and_removed(learned, joint, size):
    offset = tuple(size if k == joint else 0.0 for k in range(3))
    features, q = _poses(7, offset=offset)
    found = estimate_from_features(features, learned, EstimationSettings())
    (fault,) = found.faults
    assert (fault.sense, fault.name, fault.kind) == ("encoders", JOINTS[joint], "offset")
    assert abs(fault.size - size) < 0.002
    assert np.sqrt(np.mean((found.joints.values - q) ** 2)) < 0.002
    left_in = estimate_from_features(
        features, learned, EstimationSettings(bias="off", precision="model")
    )
    assert np.sqrt(np.mean((left_in.joints.values - q) ** 2)) > 0.009


def test_sound_poses_have_no_fault(learned):
    for seed in range(8, 11):
        assert estimate_from_features(_poses(seed)[0], learned, EstimationSettings()).faults == ()


def test_places_alone_find_the_pose(learned):
    features, q = _poses(20)
    found = estimate_from_features(features, learned, EstimationSettings(senses=("vision",)))
    assert np.sqrt(np.mean((found.joints.values - q) ** 2)) < 0.01 and 0.6 < _nees(found, q) < 1.6


def test_pose_is_robust_to_one_wrong_sighting(learned):
    features, _ = _poses(21, noise=0.01)
    track = features.tracks["left/hand_marker"]
    wrong = track.values.copy()
    wrong[5] += 80.0
    tracks = {**features.tracks, "left/hand_marker": replace(track, values=wrong)}
    clean, found = (
        estimate_from_features(f, learned, EstimationSettings())
        for f in (features, replace(features, tracks=tracks))
    )
    std = np.sqrt(np.einsum("pmm->pm", found.cov))[5]
    assert (np.abs(found.joints.values - clean.joints.values)[5] < 3.0 * std).all()
    assert np.abs(found.errors["left/hand_marker"].values[5]).max() > 20.0


def test_poses_are_independent_of_their_order(learned):
    features, _ = _poses(22, noise=0.02)
    order = np.random.default_rng(0).permutation(POSES)
    tracks = {n: replace(s, values=s.values[order]) for n, s in features.tracks.items()}
    turned = replace(
        features,
        joints=replace(features.joints, values=features.joints.values[order]),
        tracks=tracks,
    )
    one, two = (
        estimate_from_features(f, learned, EstimationSettings()) for f in (features, turned)
    )
    np.testing.assert_allclose(two.joints.values, one.joints.values[order], atol=2e-6)


def test_descended_pose_has_the_lowest_cost_nearby(learned):
    features, _ = _poses(23, noise=0.01)
    from bodylog.estimation.faults.screening import screen_measurements

    sound = screen_measurements(features, learned, EstimationSettings())
    poses = collect_pose_readings(sound.encoders, sound.sightings, learned).with_encoders(
        np.full(3, 1e-4), np.zeros(3)
    )
    found = descend_poses(poses, poses.y[:, :3])
    for joint in np.eye(3):
        for step in (-1e-4, 1e-4):
            beside = descend_poses(poses, found.x + step * joint)
            np.testing.assert_allclose(beside.x, found.x, atol=2e-6)


def test_pose_evidence_is_a_dense_one_and_its_gradient_a_finite_difference():
    """Positions less those at the encoders' angles, −J e + noise, in one normal density of all poses and offsets."""
    draw = np.random.default_rng(3)
    jac, nu = draw.normal(0, 200, (20, 6, 3)), draw.normal(0, 2, (20, 6))
    var = np.where(draw.random((20, 6)) < 0.2, np.inf, 0.3)
    lean = np.swapaxes(jac / var[..., None], 1, 2)
    read, span = draw.random((20, 3)) < 0.8, np.array([0.5, 0.4, 0.3])
    errors = EncoderErrors(lean @ jac, -(lean @ nu[..., None])[..., 0], read, span)
    seen = np.isfinite(var).ravel()

    def dense(log_var, free):
        slopes = -(jac * read[:, None]).reshape(-1, 3)
        own = [
            j @ np.diag(np.where(r, np.exp(log_var), span**2)) @ j.T
            for j, r in zip(jac, read, strict=True)
        ]
        cov = (
            block_diag(*own)
            + 0.3 * np.eye(120)
            + 0.3**2 * slopes @ np.diag(free.astype(float)) @ slopes.T
        )
        some = np.linalg.slogdet(cov[np.ix_(seen, seen)])[1]
        return -0.5 * (
            nu.ravel()[seen] @ np.linalg.solve(cov[np.ix_(seen, seen)], nu.ravel()[seen]) + some
        )

    for free in (np.zeros(3, bool), np.array([False, True, True])):
        at, other = np.log([1e-4, 1e-5, 1e-3]), np.log([3e-4, 2e-5, 1e-4])
        value, slope, *_ = compute_position_evidence(at, errors, free)
        for k, step in enumerate(np.eye(3) * 1e-5):
            rise = (
                compute_position_evidence(at + step, errors, free)[0]
                - compute_position_evidence(at - step, errors, free)[0]
            ) / 2e-5
            assert abs(rise - slope[k]) < 1e-4 * max(1.0, abs(slope[k]))
        gained = compute_position_evidence(other, errors, free)[0] - value
        assert abs(gained - (dense(other, free) - dense(at, free))) < 1e-6 * abs(gained)


def test_methods_that_follow_a_motion_are_refused(learned):
    with pytest.raises(UsageError, match="the log has still poses; type filter"):
        estimate_from_features(_poses(1)[0], learned, EstimationSettings(method="kalman"))


def test_time_between_poses_is_no_silence(learned):
    """Poses stand 2 s apart, which in a motion would be a silence of all encoders."""
    found, _ = _poses(1)
    apart = {name: replace(one, t=2 * one.t) for name, one in found.tracks.items()}
    joints = replace(found.joints, t=2 * found.joints.t)
    result = estimate_from_features(
        replace(found, joints=joints, tracks=apart), learned, EstimationSettings()
    )
    assert not [one.text for one in result.findings if "silent" in one.text]


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_two_numbers_for_three_joints_do_not_make_an_encoder_sure(learned, noise):
    """Evidence alone would take two of the three encoders for almost exact: NEES of 68 and 400."""
    found = []
    for seed in range(1, 5):
        features, q = _poses(seed, noise)
        joints, track = (
            _first(series, 40) for series in (features.joints, features.tracks["hand_marker"])
        )
        belief = estimate_from_features(
            replace(features, joints=joints, tracks={"hand_marker": track}),
            learned,
            EstimationSettings(),
        )
        found.append(_nees(belief, q[:40]))
    assert 0.3 < np.mean(found) < 4.0


def _first(series, count):
    rows = slice(count)
    return replace(
        series, t=series.t[rows], values=series.values[rows], source_ns=series.source_ns[rows]
    )


@pytest.mark.parametrize("variance", [1e-4, 1e-9, 1e-16, 1e-18])
def test_a_reading_that_no_other_foretells_has_no_error_made_of_rounding(learned, variance):
    features, _ = _poses(3)
    alone = replace(features, tracks={})
    found = estimate_from_features(
        alone, learned, EstimationSettings(sigma_encoders=variance, precision="model", bias="off")
    )
    encoder_errors = found.errors["encoders"].values
    span = np.ptp(np.concatenate([sense.samples for sense in learned.senses.values()]), axis=0)
    if variance < 1e-12 * span.min() ** 2:
        assert not np.isfinite(encoder_errors).any()
    else:  # without its own reading, a joint is where the body was explored
        low, high = (end(learned.senses["hand_marker"].samples, axis=0) for end in (np.min, np.max))
        expected = (alone.joints.values - (low + high) / 2.0) / np.sqrt(variance + span**2)
        np.testing.assert_allclose(encoder_errors, expected, rtol=0.05, atol=0.02)
    assert np.isfinite(found.cov).all() and np.isfinite(found.joints.values).all()

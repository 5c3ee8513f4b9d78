"""A sense of six correlated rows: a tag's pose, read, predicted and used by the filter."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from bodylog.body_model import BodyModel, Noise, TouchConstants
from bodylog.estimation import estimate_from_features
from bodylog.estimation.inference.filter_pass import FilterDynamics
from bodylog.estimation.inference.sequential import SequentialFilter
from bodylog.estimation.measurements import gather, track
from bodylog.estimation.noise.correlated_noise import ErrorCorrelation, LastFrame, PendingFrame
from bodylog.kinematics.camera import lens_without_distortion, project_points
from bodylog.kinematics.rotations import rotation_from_vector
from bodylog.settings import EstimationSettings
from bodylog.types import Features, Series
from tests.estimation.conftest import JOINTS, motion
from tests.estimation.tag_pose import ROWS, PoseModel, TagPose, solved, unambiguous
from tests.seeds import first_of

LENS = lens_without_distortion(600.0, 640.0, 480.0)
SIZE = 0.08
POINTS = 0.5 * SIZE * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])


@dataclass(frozen=True)
class Corner:
    """A corner of a tag that three joints turn and carry before a camera."""

    number: int
    outputs: tuple[str, ...] = ("u", "v")

    def place(self, x):
        pan, lift, elbow = np.moveaxis(np.asarray(x), -1, 0)
        turns = np.stack([0.5 * (lift + 0.6), pan + 0.4, elbow - 1.0], axis=-1)
        at = np.stack([0.15 * np.sin(pan + 0.9), 0.15 * np.sin(lift + 0.9), 0.55 + 0.1 * np.cos(elbow)], axis=-1)
        arms = np.array([rotation_from_vector(turn) @ POINTS[self.number] for turn in turns])
        return project_points(arms + at, LENS)[0]

    def predict(self, x):
        steps = 1e-6 * np.eye(3)
        jac = np.stack([(self.place(x + e) - self.place(x - e)) / 2e-6 for e in steps], axis=-1)
        return self.place(x), jac, np.zeros((len(x), 2))


MODELS = tuple(Corner(k) for k in range(4))
TRACKS = tuple(f"tag.{k}" for k in range(4))


PROCESS = 0.002
TYPED = EstimationSettings(precision="model", bias="off", process=PROCESS)


def white(t, rng):
    """Angles (N,3) under white acceleration of PROCESS rad²/s³."""
    grid = np.arange(0.0, t.max() + 0.01, 0.001)
    rate = np.cumsum(rng.normal(0.0, np.sqrt(PROCESS * 0.001), (len(grid), 3)), axis=0)
    path = np.array([-0.9, -0.9, 1.0]) + np.cumsum(0.001 * rate, axis=0)
    return np.stack([np.interp(t, grid, column) for column in path.T], axis=1)


def drawn(seed, duration=8.0, pixel=0.2, encoder=0.02, hz=50.0, camera=12.0):
    rng = np.random.default_rng(seed)
    t, frames = np.arange(0.0, duration, 1 / hz), np.arange(0.003, duration, 1 / camera)
    both = np.concatenate([t, frames])
    x = white(both, rng)
    ns = (frames * 1e9).astype(np.int64)
    std = np.full((len(frames), 2), pixel)
    tracks = {
        name: Series(frames, model.place(x[len(t) :]) + rng.normal(0.0, pixel, std.shape), ("u", "v"), "px", ns, std)
        for name, model in zip(TRACKS, MODELS, strict=True)
    }
    joints = Series(t, x[: len(t)] + rng.normal(0.0, encoder, (len(t), 3)), JOINTS, "rad", (t * 1e9).astype(np.int64))
    features = Features(joints, tracks, None, (), (), {}, boards={"tag": (TRACKS, POINTS)})
    noise = Noise((encoder**2,) * 3, dict.fromkeys(TRACKS, (pixel**2,) * 2), (0.3,) * 3)
    body = BodyModel(JOINTS, dict(zip(TRACKS, MODELS, strict=True)), noise, TouchConstants(1.0, 0.005), {})
    return features, body, x[: len(t)], x[len(t) :]


def filtered(features, body, process, poses):
    """The belief at each encoder instant, by a filter that goes instant by instant: (N,3), (N,3,3)."""
    joints, steps = features.joints, SequentialFilter(FilterDynamics(np.full(3, process)), None)
    values, var, mix = poses.independent_rows
    like = ErrorCorrelation(np.full(3, process), np.asarray(np.inf), 0.0)
    rows = [(t, y, None) for t, y in zip(joints.t, joints.values, strict=True)]
    rows += [(t, np.full(3, np.nan), row) for row, t in enumerate(poses.t) if np.isfinite(poses.values[row]).all()]
    state, means, covs = steps.build_first_state(joints.values[0]), [], []
    for t, y, row in sorted(rows, key=lambda one: one[0]):
        frames = {} if row is None else {
            "tag": PendingFrame(poses.model, t, values[row], var[row], like, LastFrame(), mix[row])
        }  # fmt: skip
        state = steps.filter_instant(state, t, y.tolist(), body.noise.encoder, frames)
        if row is None:
            means.append(state.z[:3])
            covs.append(state.p[:3, :3])
    return np.array(means), np.array(covs)


def test_tag_pose_fits_the_corners_with_true_derivatives():
    x = motion(np.arange(0.0, 3.0, 0.5), np.random.default_rng(0), 0.3)
    model = PoseModel(MODELS, POINTS, LENS)
    mean, jac, _ = model.predict(x)
    image = np.stack([one.place(x) for one in MODELS], axis=1)
    for pose, seen in zip(mean, image, strict=True):
        again = project_points(POINTS @ rotation_from_vector(pose[3:]).T + pose[:3], LENS)[0]
        np.testing.assert_allclose(again, seen, atol=1e-7)
    numeric = np.stack([(model.predict(x + e)[0] - model.predict(x - e)[0]) / 2e-5 for e in 1e-5 * np.eye(3)], axis=-1)
    np.testing.assert_allclose(jac, numeric, atol=2e-5, rtol=1e-4)


@pytest.mark.parametrize("seed", range(2))
def test_tag_pose_has_a_true_covariance(seed):
    features, body, _, at_frames = drawn(seed, duration=10.0, pixel=0.1)
    ((poses, health),) = TagPose(LENS)(features, body).values()
    assert poses.name == "tag.pose" and poses.values.shape == (120, 6) and health.used > 100
    rows = np.isfinite(poses.values[:, 0])
    error = (poses.values - poses.model.predict(at_frames)[0])[rows]
    nees = np.einsum("nd,nd->n", error, np.linalg.solve(poses.cov[rows], error[..., None])[..., 0])
    assert 0.85 < nees.mean() / 6.0 < 1.15
    # their errors are correlated: depth and tilt come from the same pixels
    scale = np.sqrt(np.einsum("ndd->nd", poses.cov[rows]))
    assert np.abs(poses.cov[rows] / (scale[:, :, None] * scale[:, None]) - np.eye(6)).max() > 0.5


@pytest.fixture
def pose_alone(monkeypatch):
    """Of all senses only the encoders and the tag's pose."""
    monkeypatch.setattr(gather, "SENSES", (("vision", TagPose(LENS)),))


@pytest.mark.parametrize("seed", range(2))
def test_estimate_with_tag_poses_equals_the_filter_instant_by_instant(pose_alone, seed):
    features, body, _, _ = drawn(seed, duration=4.0, pixel=0.1, camera=6.0)
    found = estimate_from_features(features, body, TYPED)
    assert found.used["tag.pose"].used > 20 and found.predicted["tag.pose"].names == ROWS
    poses, _ = TagPose(LENS)(features, body)["tag.pose"]
    mean, cov = filtered(features, body, PROCESS, poses)
    np.testing.assert_allclose(found.joints.values, mean, atol=1e-7, rtol=0)
    np.testing.assert_allclose(found.cov, cov, atol=1e-9, rtol=0)


@pytest.mark.parametrize("method", first_of(1, ["smoother", "filter"]))
def test_estimate_with_tag_poses_has_true_error_bars(pose_alone, method):
    found = {True: [], False: []}
    for seed in range(6):
        features, body, truth, _ = drawn(seed, duration=4.0, pixel=0.1, camera=6.0)
        for seen in found:
            senses = ("encoders", "vision") if seen else ("encoders",)
            belief = estimate_from_features(features, body, replace(TYPED, method=method, senses=senses))
            error = (belief.joints.values - truth)[50:]
            nees = np.mean(error**2 / np.einsum("nii->ni", belief.cov[50:]))
            found[seen].append((np.sqrt(np.mean(error**2)), nees))
            if seen and method == "filter":
                assert 0.7 < np.mean(belief.errors["tag.pose"].values ** 2) < 1.3
    (rmse, nees), (without, _) = np.mean(found[True], axis=0), np.mean(found[False], axis=0)
    assert rmse < 0.7 * without and 0.8 < nees < 1.25


def test_noise_is_learned_beside_poses_and_corners(monkeypatch):
    features, body, truth, _ = drawn(1, duration=3.0, pixel=0.1, camera=6.0)
    errors = []
    for senses in ((("vision", track.read_tracks),), (("vision", track.read_tracks), ("vision", TagPose(LENS)))):
        monkeypatch.setattr(gather, "SENSES", senses)
        found = estimate_from_features(features, body, EstimationSettings(method="smoother"))
        errors.append(np.sqrt(np.mean((found.joints.values - truth) ** 2)))
        assert ("tag.pose" in found.errors) == (len(senses) > 1) and not found.faults
    assert errors[1] < 1.1 * errors[0]


def test_tag_pose_is_absent_for_an_ambiguous_far_tag():
    at, turn = np.array([0.0, 0.0, 6.0]), rotation_from_vector(np.array([0.25, 0.0, 0.0]))
    corners = project_points(POINTS @ turn.T + at, LENS)[0]
    assert unambiguous(corners, np.full(8, 0.04), POINTS, LENS) is None
    near = project_points(POINTS @ turn.T + 0.05 * at, LENS)[0]
    pose = unambiguous(near, np.full(8, 0.04), POINTS, LENS).pose
    np.testing.assert_allclose(pose, [0.0, 0.0, 0.3, 0.25, 0.0, 0.0], atol=1e-6)
    assert solved(near, np.full(8, 0.04), POINTS, LENS).cost < 1e-9


def test_tag_pose_is_absent_without_all_corners():
    features, body, _, _ = drawn(3, duration=1.0)
    values = features.tracks["tag.2"].values.copy()
    values[4] = np.nan
    hidden = replace(features, tracks={**features.tracks, "tag.2": replace(features.tracks["tag.2"], values=values)})
    poses, health = TagPose(LENS)(hidden, body)["tag.pose"]
    assert np.isnan(poses.values[4]).all() and health.used <= 11

"""Residuals that several tracks share in still poses are errors of the joints."""

from pathlib import Path

import numpy as np
import pytest

from bodylog import body, pipeline
from bodylog.body import storage
from bodylog.settings import BodySettings, Settings
from bodylog.types import Features, Series

JOINTS = ("pan", "lift", "elbow")
MOTOMAN = Path(__file__).parents[3] / "shared" / "real" / "motoman" / "leica_left_hand_6x6x6.csv"


def _places(q: np.ndarray, turn: float, fore: float) -> np.ndarray:
    """Pixels (N,2) of a point on the forearm, seen by a pinhole camera turned by `turn` rad."""
    pan, lift, elbow = q[:, 0] + turn, q[:, 1], q[:, 2]
    reach = 0.42 * np.cos(lift) + fore * np.cos(lift + elbow)
    depth = 1.6 - reach * np.cos(pan)
    height = 0.42 * np.sin(lift) + fore * np.sin(lift + elbow)
    return np.column_stack(
        [320 + 560 * reach * np.sin(pan) / depth, 240 - 560 * (height - 0.3) / depth]
    )


@pytest.mark.parametrize("seed", range(2))
def test_errors_of_joints_are_learned_from_residuals_that_tracks_share(seed, tmp_path):
    draw, std = np.random.default_rng(seed), np.array([0.002, 0.004, 0.003])
    q = np.array([0.0, 0.3, 0.6]) + draw.uniform(-0.5, 0.5, (200, 3))
    t, ns = np.arange(200.0), np.arange(200) * 10**9
    joints = Series(t, q + draw.normal(0, std, q.shape), JOINTS, "rad", ns)
    tracks = {}
    for turn in (-0.5, 0.0, 0.5):
        for fore in (0.39, 0.2):
            seen = _places(q, turn, fore) + draw.normal(0, 0.3, (200, 2))
            tracks[f"track{len(tracks)}"] = Series(t, seen, ("u", "v"), "px", ns)
    found = body.learn_body(
        [Features(joints, tracks, None, (), (), {}, poses=True)],
        Settings(body=BodySettings(joints=JOINTS)),
        {},
    )
    learned = np.sqrt(found.model.noise.encoder)
    assert np.all(np.abs(np.log(learned / std)) < 0.3)
    assert all(
        0 < e < v for e, v in zip(found.model.noise.std_error["encoder"], learned**2, strict=True)
    )
    storage.save(found.model, tmp_path / "body.npz")
    np.testing.assert_allclose(
        storage.load_body(tmp_path / "body.npz").provenance["pose_std"], learned
    )


def test_shared_errors_of_models_of_too_few_poses_are_no_encoder_errors():
    """Two dozen poses of three joints: tracks share errors of tens of pixels."""
    draw = np.random.default_rng(5)
    q = draw.uniform(-1.5, 1.5, (24, 3))
    t, ns = np.arange(24.0), np.arange(24) * 10**9
    tracks = {
        f"track{k}": Series(
            t, _places(q, turn, fore) + draw.normal(0, 0.3, (24, 2)), ("u", "v"), "px", ns
        )
        for k, (turn, fore) in enumerate(
            (turn, fore) for turn in (-0.2, 0.0, 0.2) for fore in (0.39, 0.37, 0.35)
        )
    }
    features = Features(Series(t, q, JOINTS, "rad", ns), tracks, None, (), (), {}, poses=True)
    found = body.learn_body([features], Settings(), {})
    assert np.sqrt(found.model.noise.encoder).max() < 0.02


@pytest.fixture(scope="module")
def motoman(tmp_path_factory):
    """A body of 144 real poses, and the 72 withheld, every third."""
    if not MOTOMAN.is_file():
        pytest.skip("the measured poses (../shared/real/motoman) are not at hand")
    # the images alone: the last three columns are a laser tracker's
    head, *rows = (line.rsplit(",", 3)[0] for line in MOTOMAN.read_text().splitlines())
    folder = tmp_path_factory.mktemp("motoman")
    for name, part in {
        "train": [r for k, r in enumerate(rows) if k % 3 != 2],
        "test": rows[2::3],
    }.items():
        (folder / f"{name}.csv").write_text("\n".join([head, *part]) + "\n")
    result = pipeline.fit(
        [folder / "train.csv"], folder / "body.npz", Settings(), test=[folder / "test.csv"]
    )
    return (
        storage.load_body(folder / "body.npz"),
        pipeline.observe(folder / "test.csv", Settings())[1],
        result,
    )


def _shifted(features: Features, names, by: np.ndarray) -> Features:
    from dataclasses import replace

    values = features.joints.values.copy()
    values[:, [features.joints.names.index(name) for name in names]] += by
    return replace(features, joints=replace(features.joints, values=values))


def test_real_poses_are_predicted_to_less_than_a_pixel(motoman):
    learned, _, result = motoman
    found = {score.name: score.value for score in result.scores}
    often = [n for n in learned.senses if found.get(f"sightings/test/{n}", 0) >= 35]
    assert len(often) == 14
    for axis in "uv":
        assert np.sqrt(np.mean([found[f"rmse/test_{axis}/{name}"] ** 2 for name in often])) < 0.85
    assert 0.8 < np.mean([found[f"nis/test/{name}"] for name in often]) < 1.25


@pytest.mark.parametrize(("size", "joints"), [(0.05, range(0, 6, 2)), (-0.05, range(1, 6, 2))])
def test_estimate_names_an_offset_encoder_among_real_ones(motoman, size, joints):
    learned, features, _ = motoman
    for joint, name in ((k, learned.joints[k]) for k in joints):
        found = pipeline.infer(
            _shifted(features, learned.joints, size * np.eye(6)[joint]), learned, Settings()
        )
        assert [(fault.name, fault.kind) for fault in found.faults] == [(name, "offset")]
        assert abs(found.faults[0].size - size) < 0.005
    assert pipeline.infer(features, learned, Settings()).faults == ()


def test_noisy_encoders_of_real_poses_are_corrected(motoman):
    learned, features, _ = motoman
    columns = [features.joints.names.index(name) for name in learned.joints]
    read = features.joints.values[:, columns]
    noisy = _shifted(features, learned.joints, np.random.default_rng(0).normal(0, 0.05, read.shape))
    found = pipeline.infer(noisy, learned, Settings())
    error = found.joints.values - read
    assert np.sqrt(np.mean(error**2)) < 0.0006
    assert np.einsum("pi,pij,pj->p", error, np.linalg.inv(found.cov), error).mean() / 6 < 1.7

"""A head that turns its camera is one more joint; each camera's track is a sense."""

import numpy as np
import pytest

from bodylog.body import learn_body
from bodylog.estimation import estimate_from_features
from bodylog.settings import EstimationSettings, Settings
from bodylog.types import Array, Features, Series
from tests.body.conftest import motion

JOINTS = ("pan", "lift", "elbow", "head")
BASE = np.array([1.6, 0.0, 0.3])


def _watched(q: Array, base: Array = BASE) -> Array:
    """Pixels (N,2) of the end effector at q (N,4) rad in a camera at `base` that looks back and turns with the head."""
    reach = 0.42 * np.cos(q[:, 1]) + 0.39 * np.cos(q[:, 1] + q[:, 2])
    height = 0.42 * np.sin(q[:, 1]) + 0.39 * np.sin(q[:, 1] + q[:, 2])
    x, y = base[0] - reach * np.cos(q[:, 0]), reach * np.sin(q[:, 0]) - base[1]
    ahead, aside = np.cos(q[:, 3]) * x - np.sin(q[:, 3]) * y, np.sin(q[:, 3]) * x + np.cos(q[:, 3]) * y
    return np.column_stack([160 + 280 * aside / ahead, 120 - 280 * (height - base[2]) / ahead])


def _angles(t: Array, seed: int) -> Array:
    return np.column_stack([motion(t, seed), 0.15 * np.sin(0.9 * t + seed) + 0.1 * np.sin(1.7 * t)])


def _run(seed: int, duration: float, noise: float, cameras: tuple[Array, ...] = (BASE,)) -> Features:
    """Encoders at 100 Hz, and frames of each camera at times of its own, 0.2 px of noise."""
    draw = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 0.01)
    joints = Series(t, _angles(t, seed) + draw.normal(0, noise, (len(t), 4)), JOINTS, "rad", (t * 1e9).astype(np.int64))
    tracks = {}
    for k, base in enumerate(cameras):
        at = np.arange(0.05 + 0.037 * k, duration - 0.05, 0.1 - 0.03 * k)
        seen = _watched(_angles(at, seed), base) + draw.normal(0, 0.2, (len(at), 2))
        name, std = ("side/" if k else "") + "effector", np.full(seen.shape, 0.2)
        tracks[name] = Series(at, seen, ("u", "v"), "px", (at * 1e9).astype(np.int64), std)
    return Features(joints, tracks, None, (), (), {})


@pytest.mark.parametrize("seed", range(3))
def test_learn_treats_a_turning_head_as_a_joint(seed) -> None:
    learned = learn_body([_run(seed, 60.0, 0.003)], Settings(), {})
    assert learned.model.joints == JOINTS
    later = _angles(np.arange(0.0, 20.0, 0.1), seed)
    mean, slope, _ = learned.model.senses["effector"].predict(later)
    assert np.sqrt(np.square(mean - _watched(later)).mean()) < 0.4
    assert np.abs(slope[:, 0, 3]).mean() > 200  # px per rad: turning the head moves the whole picture


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.soak) for seed in (1, 2))])
def test_estimate_with_two_cameras_is_better_than_with_either(seed) -> None:
    cameras = BASE, np.array([1.3, 0.5, 0.7])
    body = learn_body([_run(seed, 60.0, 0.003, cameras)], Settings(), {}).model
    assert set(body.senses) == {"effector", "side/effector"}
    features = _run(seed, 20.0, 0.02, cameras)
    errors = {}
    for without in ((), ("effector",), ("side/effector",), ("vision",)):
        found = estimate_from_features(features, body, EstimationSettings(without=without))
        true = _angles(found.joints.t, seed)
        errors[without] = np.sqrt(np.square(found.joints.values - true).mean())
    assert errors[()] < min(errors[("effector",)], errors[("side/effector",)]) < errors[("vision",)]

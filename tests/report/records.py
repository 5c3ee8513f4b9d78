"""A small log that never was: seeded records in the shape every stage hands to the report."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from bodylog.body_model import BodyModel, Noise, TouchConstants
from bodylog.types import (
    Array,
    Estimate,
    Fault,
    FaultKind,
    Features,
    Finding,
    Health,
    LazyImage,
    Recording,
    Score,
    Series,
    Stroke,
    Synchrony,
    Touch,
)
from tests.changed_recordings import make_recording

JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")


def series(t: Array, values: Array, names: tuple[str, ...], unit: str, std: Array | None = None) -> Series:
    return Series(t, values, names, unit, (t * 1e9).astype(np.int64), std)


def motion(t: Array, joints: int) -> Array:
    return np.stack([0.6 * np.sin(0.5 * t * (1 + 0.3 * m) + m) for m in range(joints)], axis=1)


def recording(seed: int = 0, duration: float = 20.0, joints: tuple[str, ...] = JOINTS, **changes: Any) -> Recording:
    rng = np.random.default_rng(seed)
    t, tf, ts = np.arange(0, duration, 0.02), np.arange(0, duration, 1 / 30), np.arange(0, duration, 0.01)
    x = motion(t, len(joints))
    skin = rng.uniform(0, 0.2, (len(ts), 30))
    skin[(ts % 4 > 2) & (ts % 4 < 2.8), 11:14] = 0.9
    picture = np.full((120, 160, 3), 200, np.uint8)
    fields: dict[str, Any] = {
        "name": "reach.mcap",
        "format": "mcap",
        "start_ns": 1_700_000_000_000_000_000,
        "duration_s": duration,
        "topics": (),
        "roles": {"joints": "/joint_states", "camera": "/cam/image", "skin": "/skin"},
        "joints": series(t, x + rng.normal(0, 0.02, x.shape), joints, "rad"),
        "skin": series(ts, skin, tuple(f"cell {c}" for c in range(30)), "1"),
        "truth": series(t, x, joints, "rad"),
        "frames": lambda: iter(LazyImage(s, int(s * 1e9), lambda k: picture[::k, ::k]) for s in tf.tolist()),
        "features": None,
        "health": {
            "/joint_states": Health(len(t), len(t)),
            "/skin": Health(len(ts), len(ts) - 3, {"not finite": 3}, 0.04),
        },
        "findings": (Finding("warning", "/joint_states: velocity is NaN in 12 messages"),),
    }
    return make_recording(**(fields | changes))


def features(seed: int = 0, duration: float = 20.0, **changes: Any) -> Features:
    rng = np.random.default_rng(seed + 1)
    t = np.arange(0, duration, 1 / 30)
    track = np.stack([80 + 40 * np.sin(0.5 * t), 60 + 20 * np.cos(0.7 * t)], axis=1) + rng.normal(0, 0.3, (len(t), 2))
    track[(t > 6) & (t < 8)] = np.nan
    onsets = np.arange(2.0, duration - 1, 4.0)
    touches = tuple(Touch(s, s + 0.8, (11, 12, 13), 0.9, 12, int(s * 1e9)) for s in onsets.tolist())
    strokes = tuple(Stroke(s + 0.05, s + 0.9, (40.0, 40.0), (60.0, 60.0)) for s in onsets.tolist())
    fields: dict[str, Any] = {
        "joints": None,
        "tracks": {
            "effector": series(t, track, ("u", "v"), "px", np.full((len(t), 2), 0.3)),
            "hand": series(t, track + 15, ("u", "v"), "px"),
        },
        "touches": touches,
        "strokes": strokes,
        "synchrony": tuple(Synchrony(i, i, 0.05, 0.93) for i in range(len(touches))),
        "health": {"effector": Health(len(t), len(t) - 60, {"hidden": 60})},
    }
    return Features(**(fields | changes))


def estimate(seed: int = 0, duration: float = 20.0, joints: tuple[str, ...] = JOINTS, **changes: Any) -> Estimate:
    rng = np.random.default_rng(seed + 2)
    t, tf = np.arange(0, duration, 0.02), np.arange(0, duration, 1 / 30)
    m = len(joints)
    x = motion(t, m)
    cov = np.broadcast_to(np.diag(np.full(m, 0.012**2)), (len(t), m, m)) * (1 + 3 * ((t > 6) & (t < 8)))[:, None, None]
    track = np.stack([80 + 40 * np.sin(0.5 * tf), 60 + 20 * np.cos(0.7 * tf)], axis=1)
    fields: dict[str, Any] = {
        "method": "filter",
        "joints": series(t, x + rng.normal(0, 0.006, x.shape), joints, "rad"),
        "rate": series(t, np.gradient(x, t, axis=0), joints, "rad/s"),
        "cov": cov,
        "errors": {
            "encoders": series(t, rng.normal(0, 1, x.shape), joints, "1"),
            "effector": series(tf, rng.normal(0, 1, track.shape), ("u", "v"), "1"),
        },
        "free_energy": 3 + rng.gamma(2.0, 1.0, len(t)),
        "used": {"encoders": Health(len(t), len(t)), "effector": Health(len(tf), len(tf) - 60, {"not seen": 60}, 2.0)},
        "predicted": {"effector": series(tf, track, ("u", "v"), "px", np.full(track.shape, 2.0))},
        "predicted_cov": {"effector": np.broadcast_to(np.array([[9.0, 4.0], [4.0, 5.0]]), (len(tf), 2, 2))},
        "settings": {"method": "filter", "preset": "default", "senses": None},
        "faults": (Fault("encoders", joints[0], FaultKind.DRIFTING, 8.25, 0.3, "rad"),),
    }
    return Estimate(**(fields | changes))


UNSEEN = features(tracks={}, touches=None, strokes=(), synchrony=(), health={})
"""Of a log without camera and skin."""

SCORES = (
    Score("rmse/joint", 0.0068, "rad"),
    Score("rmse/joint/elbow_joint", 0.0071, "rad"),
    Score("nees/joint", 0.97, "1"),
    Score("nees/joint/elbow_joint", 1.25, "1"),
)


@dataclass(frozen=True)
class Bowl:
    """A forward model with its samples: u = x0² − x1, v = x0 x1, more doubtful away from them."""

    samples: Array
    outputs: tuple[str, ...] = ("u", "v")

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        mean = np.stack([x[:, 0] ** 2 - x[:, 1], x[:, 0] * x[:, 1]], axis=1)
        jacobian = np.zeros((len(x), 2, x.shape[1]))
        far = ((x[:, None, :2] - self.samples[None, :, :2]) ** 2).sum(axis=2).min(axis=1)
        return mean, jacobian, np.stack([far, far], axis=1)


@dataclass(frozen=True)
class Blind:
    """A forward model that keeps no samples."""

    outputs: tuple[str, ...] = ("u",)

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        return x[:, :1], np.zeros((len(x), 1, x.shape[1])), x[:, 1:2] ** 2


def body(**changes: Any) -> BodyModel:
    x = np.random.default_rng(3).uniform(-1, 1, (46, 3)) * (1.0, 0.5, 0.01)
    fields: dict[str, Any] = {
        "joints": JOINTS,
        "senses": {"effector": Bowl(x)},
        "noise": Noise((1e-4,) * 3, {"effector": (1.0, 1.0)}, (1e-3,) * 3),
        "touch": TouchConstants(1.0, 1e-3),
        "provenance": {},
    }
    return BodyModel(**(fields | changes))

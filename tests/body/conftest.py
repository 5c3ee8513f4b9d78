"""A small arm seen by a camera, with truth: features of an exploration and of a later motion."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from bodylog.types import Array, Features, Series

JOINTS = ("pan", "lift", "elbow", "wrist")
PIXEL = 0.3


@dataclass(frozen=True)
class Run:
    """Features, and the true angles (N,3) rad and pixels (N,2) at the frame times."""

    features: Features
    angles: Array
    pixels: Array


def project(q: Array) -> Array:
    """Pixels (N,2) of the end effector at q (N,3) rad: analytic kinematics and a pinhole camera."""
    pan, lift, elbow = q[:, 0], q[:, 1], q[:, 2]
    reach = 0.42 * np.cos(lift) + 0.39 * np.cos(lift + elbow)
    height = 0.42 * np.sin(lift) + 0.39 * np.sin(lift + elbow)
    depth = 1.6 - reach * np.cos(pan)
    return np.column_stack([160 + 280 * reach * np.sin(pan) / depth, 120 - 280 * (height - 0.3) / depth])


def motion(t: Array, seed: int) -> Array:
    """Three angles (N,3) rad, each a sum of slow sines."""
    draw = np.random.default_rng(seed)
    speed = draw.uniform(0.3, 1.6, (3, 5))
    phase = draw.uniform(0, 2 * np.pi, (3, 5))
    waves = np.sin(speed[:, :, None] * t + phase[:, :, None]).sum(axis=1)
    return (np.array([0.0, 0.3, 0.6]) + 0.17 * waves.T).astype(float)


def run(seed: int, encoder: float, duration: float = 40.0, pixel: float = PIXEL, rate: float = 100.0) -> Run:
    """One log's features: encoders at `rate` Hz and frames at 10 Hz, with noise (rad, px); the wrist is still."""
    draw = np.random.default_rng(1000 + seed)
    t, frames = np.arange(0, duration, 1 / rate), np.arange(0.05, duration - 0.05, 0.1)
    angles = np.column_stack([motion(t, seed), np.full(len(t), 0.2)])
    readings = angles + draw.normal(0, encoder, angles.shape)
    truth = motion(frames, seed)
    pixels = project(truth)
    seen = pixels + draw.normal(0, pixel, pixels.shape)
    joints = Series(t, readings, JOINTS, "rad", (t * 1e9).astype(np.int64))
    std = np.full(seen.shape, 0.1)
    track = Series(frames, seen, ("u", "v"), "px", (frames * 1e9).astype(np.int64), std)
    return Run(Features(joints, {"effector": track}, None, (), (), {}), truth, pixels)


@pytest.fixture(scope="session")
def explored() -> Callable[..., Run]:
    """explored(seed, encoder, duration, pixel, rate) is one run of the arm."""
    return run


@pytest.fixture(scope="session")
def camera() -> Callable[[Array], Array]:
    """The arm's true forward model."""
    return project

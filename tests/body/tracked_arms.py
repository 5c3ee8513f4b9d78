"""An arm whose points a tracker measures in space, at still poses or along a motion."""

from dataclasses import dataclass

import numpy as np

from bodylog.kinematics import urdf
from bodylog.kinematics.chain import chain_between
from bodylog.kinematics.rotations import invert_transform, make_transform, rotation_from_vector
from bodylog.types import MM_PER_M, TRACK_AXES, Features, Series
from tests.kinematics import robots
from tests.kinematics.robots import ARM, JOINTS

NOISE_M = 1e-4
CHAIN = chain_between(urdf.parse_urdf(ARM, "arm.urdf"), "base", "hand").over(JOINTS)


@dataclass(frozen=True, eq=False)
class TrackedArm:
    """What was measured · zeros (M,) rad · tools (K,3) m in the hand · frame (4,4): the tracker in the base."""

    features: Features
    zeros: np.ndarray
    tools: np.ndarray
    frame: np.ndarray


def draw_tracked_arm(seed: int, poses: int = 60, targets: int = 2, still: int | None = None) -> TrackedArm:
    """An arm with zeros, periodic errors of joints and their repeatability as the fit has them for its priors.

    The zeros of the first and of the last joint are 0: nothing tells them from the tracker's and the tools' places.
    still: a joint that does not move, and is off by 3°.
    """
    draw = np.random.default_rng(seed)
    q = robots.angles(poses, seed + 100)
    zeros = np.array([0.0, *draw.normal(0.0, np.radians(2.0), 2), 0.0])
    if still is not None:
        q[:, still] = q[0, still]
        zeros[still] = np.radians(3.0)
    a, b = draw.normal(0.0, 1e-3, (2, 4))
    true = q + zeros + a * np.cos(q) + b * np.sin(q) + draw.normal(0.0, 1e-4, q.shape)
    seen_from = make_transform(rotation_from_vector(draw.normal(0.0, 1.0, 3)), draw.normal(0.0, 2.0, 3))
    tools = draw.uniform(-0.1, 0.1, (targets, 3))
    t = np.arange(poses, dtype=float)
    tracks = {}
    for k, tool in enumerate(tools):
        seen = measure_points(true, tool, seen_from) + draw.normal(0.0, NOISE_M, (poses, 3))
        tracks[f"tracker/ball{k}"] = points_series(t, seen)
    joints = Series(t, q, JOINTS, "rad", (t * 1e9).astype(np.int64))
    found = Features(joints, tracks, None, (), (), {}, poses=True)
    return TrackedArm(found, zeros, tools, invert_transform(seen_from))


def measure_points(angles: np.ndarray, tool: np.ndarray, seen_from: np.ndarray) -> np.ndarray:
    """Where a tracker that sees the base at seen_from (4,4) sees a tool's point (3,) m: (N,3) m."""
    arm = CHAIN.at(angles)
    return (arm.rotation @ tool + arm.place) @ seen_from[:3, :3].T + seen_from[:3, 3]


def points_series(t: np.ndarray, points_m: np.ndarray) -> Series:
    """Points (N,3) m as a track."""
    names, unit = TRACK_AXES[3]
    return Series(t, MM_PER_M * points_m, names, unit, (t * 1e9).astype(np.int64))

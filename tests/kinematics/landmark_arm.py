"""An arm of four joints, its motion, and landmarks on its links before one camera."""

from dataclasses import replace

import numpy as np

from bodylog.kinematics import urdf
from bodylog.kinematics.joint_motion import JointCurve, curve_through_samples
from bodylog.kinematics.landmark_fit import build_model
from bodylog.kinematics.landmarks import LandmarkModel, LandmarkSightings
from bodylog.kinematics.links import FREE_LENS, TF_POSE, Space
from bodylog.kinematics.rig import RigCamera
from bodylog.types import Array

JOINTS = ("pan", "lift", "elbow", "wrist")
ARM = """<robot name="arm"><link name="base"/>
<link name="shoulder"/><joint name="pan" type="revolute"><origin xyz="0 0 0.2"/>
<parent link="base"/><child link="shoulder"/><axis xyz="0 0 1"/></joint>
<link name="upper"/><joint name="lift" type="revolute"><origin xyz="0 0.1 0.1"/>
<parent link="shoulder"/><child link="upper"/><axis xyz="0 1 0"/></joint>
<link name="fore"/><joint name="elbow" type="revolute"><origin xyz="0 -0.05 0.4"/>
<parent link="upper"/><child link="fore"/><axis xyz="0 1 0"/></joint>
<link name="hand"/><joint name="wrist" type="revolute"><origin xyz="0 0 0.35"/>
<parent link="fore"/><child link="hand"/><axis xyz="0 0 1"/></joint></robot>"""
LENS = np.array([np.log(600.0), 0.0, 320.0, 240.0, -0.05, 0.0])


def motion(seed: int, duration: float = 20.0) -> JointCurve:
    """Sums of slow sines for four joints, rad."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 0.01)
    phases, rates = rng.uniform(0, 6.3, (3, 4)), rng.uniform(0.6, 2.5, (3, 4))
    q = np.sin(rates * t[:, None, None] + phases).sum(axis=1) * [0.3, 0.2, 0.3, 0.5]
    middle = np.array([0.0, 0.4, 0.9, 0.0])
    return curve_through_samples(t, q + middle)


def camera() -> RigCamera:
    """A camera 1.6 m before the arm, looking at it."""
    forward = np.array([-1.0, 0.1, -0.2]) / np.linalg.norm([-1.0, 0.1, -0.2])
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(forward, right), forward])
    anchor = np.eye(4)
    anchor[:3, :3], anchor[:3, 3] = turn, -turn @ (-1.6 * forward + [0.0, 0.0, 0.5])
    return RigCamera("camera", "base", anchor, LENS, np.concatenate([TF_POSE, FREE_LENS]))


def model(motions: list[JointCurve]) -> LandmarkModel:
    space = Space(urdf.parse_urdf(ARM, "arm.urdf"), JOINTS, {}, np.radians(5.0))
    return build_model(space, camera(), motions, np.radians(5.0))


def seen(built: LandmarkModel, phi: Array, seed: int, pieces: int = 120, noise: float = 0.2) -> tuple[LandmarkSightings, Array]:
    """Pieces of 24 frames at 12 Hz of points on the moving links, and the numbers of their bodies (K,)."""
    rng = np.random.default_rng(seed)
    body = rng.integers(1, len(built.bodies), pieces)
    places = np.array([built.bodies[b].centre + 0.35 * built.bodies[b].size * rng.standard_normal(3) for b in body])
    starts = rng.uniform(1.0, 16.0, pieces)
    t = (starts[:, None] + np.arange(24) / 12.0).ravel()
    piece = np.repeat(np.arange(pieces), 24)
    part = LandmarkSightings(piece, np.zeros(len(piece), int), t, np.full((len(t), 2), 240.0), 480.0)
    for _ in range(3):  # the row time needs the row
        part = replace(part, uv=built.predict(phi, part, body, places).image)
    wander = np.zeros((pieces, 24, 2))
    for n in range(1, 24):  # corners slide slowly
        wander[:, n] = 0.93 * wander[:, n - 1] + noise * rng.standard_normal((pieces, 2))
    return replace(part, uv=part.uv + wander.reshape(-1, 2)), body


def truth(built: LandmarkModel, delay: float = 0.0, row_time: float = 0.0) -> Array:
    phi = built.prior[0].copy()
    phi[built.of_delays], phi[built.of_row_time] = delay, row_time
    phi[:6] = [0.01, -0.008, 0.012, 0.01, -0.012, 0.008]
    return phi

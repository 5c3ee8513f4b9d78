"""Small robots, and what a camera sees of them, for tests."""

from dataclasses import replace

import numpy as np

from bodylog.kinematics import urdf
from bodylog.kinematics.calibration import Sighted
from bodylog.kinematics.camera import lens_without_distortion
from bodylog.kinematics.chain import chain_between
from bodylog.kinematics.rig import Carrier, Rig, RigCamera, Sight
from bodylog.kinematics.rotations import make_transform, rotation_from_vector

JOINTS = ("pan", "lift", "elbow", "wrist")
ARM = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/> <link name="turret"/> <link name="upper"/> <link name="fore"/> <link name="hand"/>
  <link name="tool"/>
  <joint name="pan" type="revolute"><origin xyz="0 0 0.3" rpy="0 0 0.2"/><parent link="base"/><child link="turret"/>
    <axis xyz="0 0 1"/></joint>
  <joint name="lift" type="revolute"><origin xyz="0 0.1 0" rpy="0 1.5 0.1"/><parent link="turret"/><child link="upper"/>
    <axis xyz="0 2 0"/></joint>
  <joint name="elbow" type="continuous"><origin xyz="0 -0.05 0.4" rpy="0.1 0 0"/><parent link="upper"/><child
    link="fore"/><axis xyz="0.1 1 0"/></joint>
  <joint name="wrist" type="revolute"><origin xyz="0 0 0.35" rpy="0 1.2 0"/><parent link="fore"/><child link="hand"/>
    <axis xyz="0 1 0.3"/></joint>
  <joint name="flange" type="fixed"><origin xyz="0 0.05 0.1" rpy="0.3 0 0"/><parent link="hand"/><child
    link="tool"/></joint>
</robot>
"""
"""Four joints before a base, a tool at the end."""

MIXED = """<robot name="mixed">
  <link name="a"/> <link name="b"/> <link name="c"/> <link name="d"/> <link name="e"/>
  <joint name="rail" type="prismatic"><origin xyz="0.1 0 0" rpy="0.2 0.3 0.4"/><parent link="a"/><child link="b"/>
    <axis xyz="0.6 0.8 0"/></joint>
  <joint name="turn" type="revolute"><origin xyz="0 0.2 0"/><parent link="b"/><child link="c"/>
    <axis xyz="0 0 -1"/></joint>
  <joint name="follower" type="revolute"><origin xyz="0 0 0.3"/><parent link="c"/><child link="d"/><axis xyz="1 0 0"/>
    <mimic joint="turn" multiplier="-0.5" offset="0.1"/></joint>
  <joint name="side" type="revolute"><origin xyz="0 0.1 0.3"/><parent link="a"/><child link="e"/>
    <axis xyz="0 1 0"/></joint>
</robot>
"""
"""A prismatic joint, a joint with a downward axis, a joint that mimics it, and a branch."""


def rig(doubt: float = np.radians(5.0), known: bool = True, text: str = ARM) -> Rig:
    """A camera 1.8 m before the arm, known to a centimetre and a degree or unknown, and a point on the tool."""
    robot = urdf.parse_urdf(text, "arm.urdf")
    pose = np.array([0.01] * 3 + [np.radians(1.0)] * 3) if known else np.full(6, 10.0)
    lens_doubt = np.array([0.01, 0.002, 3.0, 3.0, 0.01, 0.01]) if known else np.array([0.4, 0.02, 30.0, 30.0, 0.2, 0.2])
    anchor, stds = camera_pose() if known else np.eye(4), np.append(pose, lens_doubt)
    camera = RigCamera("camera", "base", anchor, lens_without_distortion(600.0, 640, 480), stds)
    sight = Sight("point", 0, 0, chain_between(robot, "base", "tool").over(JOINTS))
    return Rig((camera,), (Carrier("point", "tool", np.eye(4), np.full(3, 0.3)),), (sight,), JOINTS, np.full(4, doubt))


def board() -> Rig:
    """The same with a flat board of 4 × 3 corners on the tool, at an unknown pose, before an unknown camera."""
    one = rig(known=False)
    grid = np.stack(np.meshgrid(np.arange(4), np.arange(3)), axis=-1).reshape(-1, 2) * 0.05
    points = np.column_stack([grid, np.zeros(12)])
    camera = replace(one.cameras[0], anchor=camera_pose())
    anchor = make_transform(rotation_from_vector(np.array([0.2, 0.3, -0.4])), np.array([0.02, 0.0, 0.05]))
    carrier = Carrier("board", "tool", anchor, np.full(6, 10.0))
    sight = Sight("board", 0, 0, one.sights[0].chain, points)
    return Rig((camera,), (carrier,), (sight,), JOINTS, one.doubt)


def tracker(text: str = ARM) -> Rig:
    """A tracker of unknown place before the arm, and a point on the tool."""
    one = rig(known=False, text=text)
    pose = RigCamera("tracker", "base", camera_pose(), np.zeros(0), np.full(6, 10.0))
    return replace(one, cameras=(pose,))


def camera_pose() -> np.ndarray:
    """The base in the camera (4,4): 1.8 m away, the camera upright and level."""
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    return make_transform(rotation_from_vector(np.array([0.1, -0.2, 0.05])) @ turn, np.array([0.1, 0.3, 1.8]))


def truth(one: Rig, offsets: dict[str, float] | None = None, seed: int = 0) -> np.ndarray:
    """θ (P,) a little off its prior mean, the point 4 cm from the tool, and these joint zeros, rad."""
    mean, std = one.prior
    draw = np.random.default_rng(seed)
    theta = mean + draw.normal(0.0, 1.0, len(mean)) * np.minimum(std, 0.05) * 0.5
    if std[0] > 1.0:
        anchor = camera_pose()
        theta[:6] = np.concatenate([anchor[:3, 3], [0.0, 0.0, 0.0]])
    theta[one.of_carrier(0)][:3] = [0.02, -0.03, 0.02]
    theta[one.of_joints] = [(offsets or {}).get(name, 0.0) for name in one.joints]
    return theta


def angles(count: int, seed: int = 1) -> np.ndarray:
    """Joint angles (N,4) rad at random, before the camera."""
    return np.random.default_rng(seed).uniform(-0.6, 0.6, (count, 4)) + np.array([0.0, -0.6, 0.9, 0.2])


def seen(one: Rig, theta: np.ndarray, q: np.ndarray, noise: float, seed: int = 2) -> Sighted:
    """Image points of the first sight, with noise in px."""
    image = one.see(one.sights[0], theta, q).image
    return Sighted(q, image + np.random.default_rng(seed).normal(0.0, noise, image.shape), np.zeros(image.shape))

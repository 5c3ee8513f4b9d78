"""Motions of an arm that holds the camera before a marker that stands, with a wrist that stands still."""

from dataclasses import replace

import numpy as np

from bodylog import body
from bodylog.body.kinematic.learn import Robotics, learn_kinematics
from bodylog.kinematics import urdf
from bodylog.kinematics.chain import chain_between
from bodylog.kinematics.links import CameraHint
from bodylog.kinematics.rig import Sight
from bodylog.robot.model import with_robot_chain
from bodylog.settings import Settings
from bodylog.types import Features, Series
from tests.kinematics import robots
from tests.kinematics.robots import ARM, JOINTS

CENTRE = np.array([0.0, -0.6, 0.9, 1.2])
WRIST = JOINTS.index("wrist")
ENCODER_RAD = 1e-3


def rig():
    """The camera on the tool, and a marker on the base, 1 m before the camera in the middle of its way."""
    whole = robots.rig()
    robot = urdf.parse_urdf(ARM, "arm")
    to_tool = chain_to_tool().at(CENTRE[None])
    marker = np.eye(4)
    marker[:3, 3] = to_tool.place[0] + to_tool.rotation[0] @ np.array([0.05, -0.03, 1.0])
    return replace(
        whole,
        cameras=(replace(whole.cameras[0], link="tool", anchor=np.eye(4)),),
        carriers=(replace(whole.carriers[0], link="base", anchor=marker),),
        sights=(Sight("effector", 0, 0, chain_between(robot, "tool", "base").over(JOINTS)),),
    )


def chain_to_tool():
    return chain_between(urdf.parse_urdf(ARM, "arm"), "base", "tool").over(JOINTS)


def sink(angles, largest):
    """How far joints (N,4) sink under a weight at the camera, the one of the longest lever by `largest` rad."""
    chain = chain_to_tool()
    poses = chain.at(angles)
    rises = chain.slopes(poses, poses.place[:, None])[:, 0, 2]
    return -largest * rises / np.abs(rises).max()


def run(seed, duration=10.0, payload=0.0, swing_rad=0.7, push=None) -> tuple[Features, Series]:
    """The log, and where the links were: the wrist stands still, but gives way under a payload (rad).

    push (6,): of the camera, m and rad."""
    one, draw = rig(), np.random.default_rng(seed)
    theta = one.prior[0].copy()
    theta[:6] += 0.0 if push is None else push
    speed, phase = draw.uniform(0.4, 1.6, (4, 4)), draw.uniform(0, 2 * np.pi, (4, 4))
    t, frames = np.arange(0, duration, 0.01), np.arange(0.02, duration - 0.05, 0.05)

    def way(at):
        swing = swing_rad * np.sin(speed[..., None] * at + phase[..., None]).mean(axis=1).T
        swing[:, WRIST] = 0.0
        return CENTRE + swing

    links = way(t) + sink(way(t), payload)
    read = way(t) + draw.normal(0, ENCODER_RAD, links.shape)
    image = one.see(one.sights[0], theta, way(frames) + sink(way(frames), payload)).image[:, 0]
    image += draw.normal(0, 0.3, image.shape)
    ns = [(at * 1e9).astype(np.int64) for at in (t, frames)]
    track = Series(frames, image, ("u", "v"), "px", ns[1], np.full(image.shape, 0.1))
    joints = Series(t, read, JOINTS, "rad", ns[0])
    features = Features(joints, {"effector": track}, None, (), (), {}, (), (640, 480))
    return features, replace(joints, values=links)


def learn(seed=3, wrist_noise=True):
    """What is learned from an exploration."""
    return _learn(seed, wrist_noise)[0]


def explored(seed=3, wrist_noise=True):
    """The body of an exploration."""
    found, given, features = _learn(seed, wrist_noise)
    return with_robot_chain(found.model, given, [features])


def _learn(seed, wrist_noise):
    features, truth = run(seed, 20.0)
    if not wrist_noise:
        read = features.joints.values.copy()
        read[:, WRIST] = truth.values[:, WRIST]
        features = replace(features, joints=replace(features.joints, values=read))
    hint = CameraHint("tool", np.eye(4), lens=rig().cameras[0].lens, size=(640, 480))
    given = Robotics(urdf.parse_urdf(ARM, "arm"), {"": hint}, np.radians(5.0))
    plain = body.learn_body([features], Settings(), {})
    return learn_kinematics([features], Settings(), plain, given), given, features

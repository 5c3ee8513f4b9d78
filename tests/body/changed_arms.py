"""Motions of an arm whose zeros or camera changed, and the body that was learned before."""

import numpy as np

from bodylog import body
from bodylog.body.kinematic.learn import Robotics, learn_kinematics
from bodylog.kinematics import urdf
from bodylog.kinematics.links import CameraHint
from bodylog.settings import Settings
from bodylog.types import Features, Series
from tests.kinematics import robots
from tests.kinematics.robots import ARM, JOINTS

DEGREE = np.radians(1.0)
CENTRE = np.array([0.0, -0.6, 0.9, 0.2])


def run(seed=50, duration=10.0, encoder=0.01, offset=None, since=0.0, camera=None, bend=1.0, marker=0.0) -> Features:
    """A motion of the arm before the camera; `offset` rad is missing in its encoders' readings from `since` s on.

    marker (3,) m: how far it is on the hand from where it is otherwise."""
    rig, draw = robots.rig(known=False), np.random.default_rng(seed)
    theta = robots.truth(rig)
    theta[:6] += 0.0 if camera is None else camera
    theta[rig.of_carrier(0)] += marker
    speed, phase = draw.uniform(0.4, 1.6, (4, 4)), draw.uniform(0, 2 * np.pi, (4, 4))
    t, frames = np.arange(0, duration, 0.01), np.arange(0.02, duration - 0.05, 0.08)
    q, seen = (CENTRE + 0.8 * np.sin(speed[..., None] * at + phase[..., None]).mean(axis=1).T for at in (t, frames))
    read = q + draw.normal(0, encoder, q.shape)
    for name, value in (offset or {}).items():
        read[:, JOINTS.index(name)] -= value * (t >= since)
    image = rig.see(rig.sights[0], theta, seen).image[:, 0]
    image += bend * np.column_stack([np.sin(2 * seen[:, 1]), np.cos(1.5 * seen[:, 2] + seen[:, 0])])
    image += draw.normal(0, 0.3, image.shape)
    ns = [(at * 1e9).astype(np.int64) for at in (t, frames)]
    track = Series(frames, image, ("u", "v"), "px", ns[1], np.full(image.shape, 0.1))
    joints = Series(t, read, JOINTS, "rad", ns[0])
    return Features(joints, {"effector": track}, None, (), (), {}, (), (640, 480))


def explored(seed=3):
    features, given = run(seed, 16.0, 0.003), Robotics(urdf.parse_urdf(ARM, "arm"), {"": CameraHint()}, 5 * DEGREE)
    return learn_kinematics([features], Settings(), body.learn_body([features], Settings(), {}), given).model


def explored_without_urdf(*logs):
    """The body of an exploration, on axes that are found from it."""
    features = logs or (run(3, 16.0, 0.003),)
    return body.with_kinematics(features, Settings(), body.learn_body(features, Settings(), {}), None).model

"""Still poses of an arm with a URDF, before a lens that no kinematics explains."""

import numpy as np

from bodylog.body.kinematic.learn import Robotics
from bodylog.kinematics import urdf
from bodylog.kinematics.links import CameraHint
from bodylog.types import Features, Series
from tests.kinematics import robots
from tests.kinematics.robots import ARM, JOINTS

DEGREE = np.radians(1.0)
OFFSETS = {"lift": 2.0 * DEGREE, "elbow": -1.0 * DEGREE}


def features(count=60, bend=3.0, noise=0.3, drift=0.0, seed=1) -> Features:
    """Still poses of the arm, with an image distortion that kinematics does not explain."""
    rig = robots.rig(known=False)
    q = robots.angles(count, seed)
    draw = np.random.default_rng(seed + 50)
    image = rig.see(rig.sights[0], robots.truth(rig, OFFSETS), q).image[:, 0] + bend_places(q, bend)
    image += draw.normal(0.0, noise, image.shape) + drift * np.linspace(-1, 1, count)[:, None]
    t = np.arange(count, dtype=float)
    ns = (t * 1e9).astype(np.int64)
    track = Series(t, image, ("u", "v"), "px", ns)
    return Features(
        Series(t, q, JOINTS, "rad", ns),
        {"effector": track},
        None,
        (),
        (),
        {},
        (),
        (640, 480),
        poses=True,
    )


def bend_places(q, size):
    return size * np.column_stack(
        [np.sin(2 * q[:, 1]) * np.cos(q[:, 2]), np.cos(1.5 * q[:, 2] + q[:, 0])]
    )


def given(text=ARM, doubt=5 * DEGREE) -> Robotics:
    return Robotics(urdf.parse_urdf(text, "arm.urdf"), {"": CameraHint(size=(640, 480))}, doubt)

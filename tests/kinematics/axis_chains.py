"""Chains of axes in any place, before a camera or a tracker, drawn from a seed."""

import numpy as np
import pytest

from bodylog.kinematics.axis_chain import AxisChain
from bodylog.kinematics.camera import lens_without_distortion
from bodylog.kinematics.rotations import rotation_from_vector

LENS = lens_without_distortion(280.0, 320.0, 240.0)
LENSES = pytest.mark.parametrize("lens", [LENS + np.array([0, 0, 0, 0, 0.1, 0.05]), np.zeros(0)], ids=["camera", "tracker"])


def draw_chain(seed: int, joints: int, lens: np.ndarray) -> AxisChain:
    draw = np.random.default_rng(seed)
    frames = np.array([rotation_from_vector(v) for v in draw.normal(size=(joints, 3))])
    pivots = np.array([0.0, 0.0, 1.0]) + draw.normal(0.0, 0.3, (joints, 3))
    order = draw.permutation(joints)
    return AxisChain(np.array([0.1, 0.2, 1.0]), lens, frames, pivots, order, np.full(joints, 0.1))

"""Poses against another library, slopes against finite differences."""

import numpy as np
import pytest

from bodylog.errors import ModelError
from bodylog.kinematics import urdf
from bodylog.kinematics.chain import chain_between
from tests.kinematics.bullet import ends_of
from tests.kinematics.robots import ARM, JOINTS, MIXED

STEP = 1e-6


@pytest.mark.parametrize(
    ("text", "start", "end"), [(ARM, "base", "tool"), (ARM, "tool", "base"), (MIXED, "e", "d"), (MIXED, "d", "b")]
)
def test_poses_are_those_of_another_library(text, start, end, tmp_path):
    pybullet = pytest.importorskip("pybullet")
    chain = chain_between(urdf.parse_urdf(text, "r"), start, end)
    for q in np.random.default_rng(3).uniform(-1.5, 1.5, (3, len(chain.joints))):
        ends = ends_of(pybullet, text, dict(zip(chain.joints, q, strict=True)), tmp_path)
        pose, poses = np.linalg.inv(ends[start]) @ ends[end], chain.at(q[None])
        np.testing.assert_allclose(poses.rotation[0], pose[:3, :3], atol=1e-6)
        np.testing.assert_allclose(poses.place[0], pose[:3, 3], atol=1e-6)


@pytest.mark.parametrize(("text", "start", "end"), [(ARM, "base", "tool"), (MIXED, "e", "d")])
def test_slopes_are_finite_differences(text, start, end):
    chain = chain_between(urdf.parse_urdf(text, "r"), start, end)
    q = np.random.default_rng(4).uniform(-1, 1, (6, len(chain.joints)))
    points = np.array([[0.1, 0.2, -0.1], [0.0, 0.0, 0.0]])

    def placed(q):
        poses = chain.at(q)
        return points @ poses.rotation.transpose(0, 2, 1) + poses.place[:, None], poses

    there, poses = placed(q)
    found = chain.slopes(poses, there)
    steps = STEP * np.eye(len(chain.joints))
    numeric = np.stack([(placed(q + s)[0] - placed(q - s)[0]) / (2 * STEP) for s in steps], axis=-1)
    np.testing.assert_allclose(found, numeric, atol=1e-8)


def test_strides_are_how_the_end_moves_as_links_grow():
    chain = chain_between(urdf.parse_urdf(ARM, "r"), "base", "tool")
    q = np.random.default_rng(5).uniform(-1, 1, (4, 4))
    poses = chain.at(q)
    for k in range(3):
        longer = chain_between(urdf.parse_urdf(ARM, "r"), "base", "tool")
        longer.fixed[k + 1, :3, 3] *= 1.0 + STEP
        np.testing.assert_allclose((longer.at(q).place - poses.place) / STEP, poses.strides[:, k], atol=1e-8)


def test_held_joints_leave_the_others_poses():
    chain = chain_between(urdf.parse_urdf(ARM, "r"), "base", "tool")
    q = np.random.default_rng(6).uniform(-1, 1, (3, 4))
    q[:, 1] = 0.4
    held = chain.holding({"lift": 0.4})
    assert held.joints == ("pan", "elbow", "wrist")
    np.testing.assert_allclose(held.at(q[:, [0, 2, 3]]).place, chain.at(q).place, atol=1e-12)
    turned = chain.over(JOINTS[::-1])
    np.testing.assert_allclose(turned.at(q[:, ::-1]).rotation, chain.at(q).rotation, atol=1e-12)


def test_unknown_links_and_unsupported_joints_are_named():
    robot = urdf.parse_urdf(ARM.replace('type="continuous"', 'type="floating"'), "arm.urdf")
    with pytest.raises(ModelError, match="'elbow' between base and tool is floating"):
        chain_between(robot, "base", "tool")
    with pytest.raises(ModelError, match="no link 'head'"):
        chain_between(robot, "base", "head")

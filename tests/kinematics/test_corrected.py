"""A corrected URDF at q is the old one at q + zeros, by this program and by another."""

import re

import numpy as np
import pytest

from bodylog.errors import ModelError
from bodylog.kinematics import urdf
from bodylog.kinematics.chain import chain_between
from bodylog.kinematics.corrected import CameraFrame, correct_urdf
from bodylog.kinematics.rotations import make_transform, rotation_from_vector
from tests.kinematics.bullet import ends_of
from tests.kinematics.robots import MIXED

ZEROS = {"rail": 0.02, "turn": 0.1, "side": -0.2}


def test_written_zeros_move_the_joints_exactly(tmp_path):
    text = correct_urdf(MIXED, "m.urdf", ZEROS)
    for start, end in (("e", "d"), ("a", "c"), ("d", "b")):
        old, new = (chain_between(urdf.parse_urdf(one, "m"), start, end) for one in (MIXED, text))
        q = np.random.default_rng(1).uniform(-1, 1, (5, len(old.joints)))
        off = np.array([ZEROS[name] for name in old.joints])
        np.testing.assert_allclose(new.at(q).place, old.at(q + off).place, atol=1e-12)
        np.testing.assert_allclose(new.at(q).rotation, old.at(q + off).rotation, atol=1e-12)
    pybullet = pytest.importorskip("pybullet")
    angles = {"rail": 0.1, "turn": -0.4, "side": 0.3}
    moved = {name: angles[name] + ZEROS[name] for name in angles}
    old, new = ends_of(pybullet, MIXED, moved, tmp_path), ends_of(pybullet, text, angles, tmp_path)
    for link in ("b", "c", "e"):  # d mimics another joint, which PyBullet ignores
        np.testing.assert_allclose(new[link], old[link], atol=1e-6)


POSE = make_transform(rotation_from_vector(np.array([0.3, -2.0, 0.4])), np.array([0.05, -0.02, 0.1]))
EYE = """  <link name="eye_optical"/>
  <joint name="mount" type="fixed"><origin xyz="0.1 0 0" rpy="0 0.2 0"/><parent link="c"/>
    <child link="eye_optical"/></joint>
"""


@pytest.mark.parametrize(("link", "moved"), [("c", "cam_optical_frame"), ("eye_optical", "eye_optical")])
def test_a_camera_and_zeros_move_exactly_for_another_library(link, moved, tmp_path):
    before = MIXED.replace("</robot>", f"{EYE}</robot>")
    text = correct_urdf(before, "m.urdf", ZEROS, [CameraFrame(link, "cam_optical_frame", POSE)])
    angles = {"rail": 0.1, "turn": -0.4, "side": 0.3}
    q = [[angles["rail"], angles["turn"]]]
    turned = [[angles["rail"] + ZEROS["rail"], angles["turn"] + ZEROS["turn"]]]
    there = chain_between(urdf.parse_urdf(before, "m"), "a", link).at(np.array(turned))
    expected = make_transform(there.rotation[0], there.place[0]) @ POSE
    here = chain_between(urdf.parse_urdf(text, "m"), "a", moved).at(np.array(q))
    np.testing.assert_allclose(make_transform(here.rotation[0], here.place[0]), expected, atol=1e-12)
    again = correct_urdf(text, "m.urdf", {}, [CameraFrame(link, "cam_optical_frame", POSE)])
    assert again == text if moved != link else again != text  # a link of our own is written over
    pybullet = pytest.importorskip("pybullet")
    np.testing.assert_allclose(ends_of(pybullet, text, angles, tmp_path)[moved], expected, atol=1e-6)


def test_a_camera_is_not_written_over_another_link():
    with pytest.raises(ModelError, match="'d' is there, but no fixed joint holds it on 'a'"):
        correct_urdf(MIXED, "m.urdf", {}, [CameraFrame("a", "d", POSE)])
    with pytest.raises(ModelError, match="no link 'head'; possible: a, b"):
        correct_urdf(MIXED, "m.urdf", {}, [CameraFrame("head", "d", POSE)])


def test_all_else_in_the_file_stays():
    bare = MIXED.replace('<origin xyz="0 0.2 0"/>', "<!-- é < here > -->").replace(
        '<origin xyz="0 0.1 0.3"/>', "<origin xyz='0 0.1 0.3'></origin>"
    )
    lines = bare.replace("\n", "\r\n").replace("<robot", "<!-- ours -->\n<robot", 1)
    text = correct_urdf(lines, "m.urdf", ZEROS)
    assert re.sub("<origin [^>]*?/?>", "", text) == re.sub("<origin [^>]*?/?>", "", lines)
    assert text.count("<origin") == lines.count("<origin") + 1
    np.testing.assert_allclose(
        chain_between(urdf.parse_urdf(text, "m"), "a", "c").at(np.zeros((1, 2))).place,
        chain_between(urdf.parse_urdf(lines, "m"), "a", "c").at(np.array([[0.02, 0.1]])).place, atol=1e-12,
    )  # fmt: skip
    assert correct_urdf(lines, "m.urdf", {}) == lines


def test_corrected_names_an_unknown_joint():
    with pytest.raises(ModelError, match="no joint 'knee'"):
        correct_urdf(MIXED, "m.urdf", {"knee": 0.1})

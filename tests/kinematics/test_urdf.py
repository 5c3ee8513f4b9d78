"""Parsing a URDF, and errors that name what is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.errors import FormatError
from bodylog.kinematics import robot as robot_tree
from bodylog.kinematics import urdf
from tests.kinematics.robots import ARM, MIXED


def test_joints_and_links_are_read_with_unit_axes():
    robot = urdf.parse_urdf(ARM, "arm.urdf")
    assert robot.root == "base" and robot.by_name["lift"].axis.tolist() == [0.0, 1.0, 0.0]
    follower = urdf.parse_urdf(MIXED, "m.urdf").by_name["follower"].mimic
    assert follower is not None and (follower.joint, follower.multiplier, follower.offset) == ("turn", -0.5, 0.1)


def test_chain_order_follows_the_chain_and_not_the_alphabet():
    arm = urdf.parse_urdf(ARM, "arm.urdf")
    order = [name for name in arm.chain_order() if arm.by_name[name].kind in robot_tree.MOVING]
    assert order == ["pan", "lift", "elbow", "wrist"]
    shuffled = replace(arm, joints=arm.joints[::-1])
    assert [name for name in shuffled.chain_order() if name in order] == order


LIES = {
    "type is 'screw'": ARM.replace('type="continuous"', 'type="screw"'),
    "axis is '0 0 0'": ARM.replace('axis xyz="0 2 0"', 'axis xyz="0 0 0"'),
    "xyz is '0 0 nan'": ARM.replace('xyz="0 0 0.3"', 'xyz="0 0 nan"'),
    "possible: 3 finite": ARM.replace('rpy="0.1 0 0"', 'rpy="0.1 0"'),
    "link 'gone', which is not declared": ARM.replace('link="tool"/></joint>', 'link="gone"/></joint>'),
    "hangs on two joints": ARM.replace('link="tool"/></joint>', 'link="turret"/></joint>'),
    "in a loop": ARM.replace('parent link="base"', 'parent link="tool"'),
    "link 'hand' is declared twice": ARM.replace('<link name="base"/>', '<link name="base"/><link name="hand"/>'),
    "hang on no joint": ARM.replace('<link name="base"/>', '<link name="base"/><link name="lonely"/>'),
    "joint 'flange': has no <parent": ARM.replace('<parent link="hand"/>', ""),
    "mimics 'nobody'": MIXED.replace('mimic joint="turn"', 'mimic joint="nobody"'),
    "mimics itself": MIXED.replace('mimic joint="turn"', 'mimic joint="follower"'),
    "begins with <sdf>": "<sdf/>",
    "not XML": "a: 1",
    "xacro": ARM.replace('name="arm">', 'name="arm" xmlns:xacro="x"><xacro:macro/>'),
    "DOCTYPE": '<!DOCTYPE r [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><robot>&b;</robot>',
    "has no <link>": "<robot/>",
    "100 deep": "<robot>" + "<a>" * 100_000 + "</a>" * 100_000 + "</robot>",
    "not XML (": ARM.replace("arm", "\udc80\x00"),
}


@pytest.mark.parametrize("why", LIES)
def test_invalid_urdfs_are_refused_in_one_line_that_names_the_file(why):
    with pytest.raises(FormatError) as refused:
        urdf.parse_urdf(LIES[why], "arm.urdf")
    text = str(refused.value)
    assert text.startswith("arm.urdf: ") and why in text and "\n" not in text


def test_implausible_lengths_are_named():
    assert robot_tree.reason_implausible(urdf.parse_urdf(ARM, "arm.urdf")) is None
    millimetres = ARM.replace('xyz="0 -0.05 0.4"', 'xyz="0 -50 400"')
    assert "'elbow' stands 403 m" in str(robot_tree.reason_implausible(urdf.parse_urdf(millimetres, "arm.urdf")))
    robot = urdf.parse_urdf(ARM, "arm.urdf")
    for joint in robot.joints:
        joint.origin[:3, 3] = 0.0
    assert "no" in str(robot_tree.reason_implausible(robot)) and "origin" in str(robot_tree.reason_implausible(robot))


def test_urdf_names_a_missing_file(tmp_path):
    with pytest.raises(FormatError, match="cannot be read"):
        urdf.load_urdf(tmp_path / "none.urdf")


def test_parsing_is_deterministic():
    first, second = (urdf.parse_urdf(MIXED, "m") for _ in range(2))
    assert all(np.array_equal(a.origin, b.origin) for a, b in zip(first.joints, second.joints, strict=True))

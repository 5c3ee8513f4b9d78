"""Joints that read outside the limits of their URDF; readings of other units give no warning."""

import numpy as np
import pytest

from bodylog.kinematics import urdf
from bodylog.kinematics.robot import Limits
from bodylog.robot.joint_limits import limit_findings
from bodylog.types import Series

NAMES = ("pan", "lift", "elbow", "grip")
LIMITS = {**dict.fromkeys(NAMES[:3], Limits(-2.0, 2.0, 0.005, "rad")), "grip": Limits(0.0, 0.04, 0.0005, "m")}


@pytest.fixture
def healthy():
    t = np.arange(0.0, 20.0, 0.01)
    motion = np.stack([1.99 * np.sin(t / 3), np.cos(t), 0.1 * t, 0.02 + 0.02 * np.sin(t)], axis=1)
    return Series(t, motion, NAMES, "rad", (t * 1e9).astype(np.int64))


def _texts(joints, values):
    moved = Series(joints.t, values, joints.names, joints.unit, joints.source_ns)
    return [(finding.severity, finding.text) for finding in limit_findings(moved, LIMITS, "arm.urdf")]


def test_limit_findings_omit_a_joint_within_its_limits(healthy):
    assert _texts(healthy, healthy.values) == []
    assert _texts(healthy, np.full_like(healthy.values, np.nan)) == []
    assert _texts(healthy, healthy.values + np.array([0.015, 0.0, 0.0, 0.0])) == []  # 2.005 rad: the rounding of 2.00


def test_limit_findings_give_count_and_excess(healthy):
    values = healthy.values.copy()
    values[100:150, 2] = 2.25
    ((severity, text),) = _texts(healthy, values)
    assert severity == "warning" and "elbow: 50 of 2000 readings outside of -2 to 2 rad (arm.urdf)" in text
    assert "by up to 0.25 rad, first at 1.000 s" in text


def test_limit_findings_are_robust_to_one_outlier(healthy):
    values = healthy.values.copy()
    values[7, 0] = 1e6
    values[100:150, 2] = 2.25
    assert [severity for severity, _ in _texts(healthy, values)] == ["warning", "warning"]


@pytest.mark.parametrize("factor", [180.0 / np.pi, 4096.0 / (2 * np.pi)])
def test_degrees_and_ticks_give_no_warning(healthy, factor):
    ((severity, text),) = _texts(healthy, healthy.values * factor)
    assert severity == "info" and "other units or zeros" in text


def test_limit_findings_ignore_a_gripper_in_percent(healthy):
    values = healthy.values * [1.0, 1.0, 1.0, 2500.0]
    ((severity, text),) = _texts(healthy, values)
    assert severity == "info" and "grip: " in text and "pan" not in text
    values[:50, 0] = -2.1
    assert sorted(severity for severity, _ in _texts(healthy, values)) == ["info", "warning"]


def test_zeros_of_another_robot_give_no_warning(healthy):
    assert [severity for severity, _ in _texts(healthy, healthy.values + 1.5)] == ["info"]


JOINT = """<robot name="r"><link name="a"/><link name="b"/>
<joint name="j" type="{}"><parent link="a"/><child link="b"/>{}</joint></robot>"""
READ = {
    ("revolute", '<limit lower="-1.57" upper="3.1416"/>'): Limits(-1.57, 3.1416, 0.005, "rad"),
    ("revolute", '<limit lower="-2" upper="2" effort="1"/>'): Limits(-2.0, 2.0, 0.05, "rad"),
    ("prismatic", '<limit upper="0.040"/>'): Limits(0.0, 0.04, 0.0005, "m"),
    ("continuous", '<limit lower="-1" upper="1"/>'): None,
    ("revolute", '<limit effort="1" velocity="2"/>'): None,
    ("revolute", '<limit lower="1" upper="-1"/>'): None,
    ("revolute", '<limit lower="nan" upper="1e999"/>'): None,
    ("revolute", '<limit lower="${-pi}" upper="${pi}"/>'): None,
    ("revolute", ""): None,
}


@pytest.mark.parametrize(("kind", "limit"), READ)
def test_limits_are_read_where_they_make_sense(kind, limit):
    assert urdf.parse_urdf(JOINT.format(kind, limit), "r.urdf").by_name["j"].limits == READ[kind, limit]

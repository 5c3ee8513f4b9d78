"""Poses of a frame in a table's columns become six coordinates, whatever their form; wrong ones are named."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.body.kinematic.learn import Robotics
from bodylog.errors import LogError
from bodylog.kinematics import urdf
from bodylog.kinematics.chain import chain_between
from bodylog.kinematics.frame_robot import BASE, frame_robot
from bodylog.kinematics.rotations import (
    quaternions_from_rotations,
    rotation_from_rpy,
    rotation_from_vector,
    rpy_from_rotation,
)
from bodylog.logs.formats import open_log
from bodylog.logs.tables.frame_columns import frame_of, frame_poses
from bodylog.robot.model import joints_of_urdf
from bodylog.types import Features, Series
from tests.kinematics.robots import ARM


def poses(base, count=30, seed=0):
    """Places and rotations about one, the rotations within 40 degrees of it."""
    draw = np.random.default_rng(seed)
    rotation = np.array([base @ rotation_from_vector(draw.uniform(-0.4, 0.4, 3)) for _ in range(count)])
    return draw.uniform(-0.5, 0.8, (count, 3)), rotation


def columns(place, rotation, form):
    if form == "matrix":
        matrix = np.tile(np.eye(4), (len(place), 1, 1))
        matrix[:, :3, :3], matrix[:, :3, 3] = rotation, place
        return {f"O_T_EE_{r}{c}": matrix[:, r, c] for r in range(4) for c in range(4)}
    named = {f"tcp_{axis}": place[:, k] for k, axis in enumerate("xyz")}
    if form == "quaternion":
        turned = quaternions_from_rotations(rotation) * np.where(np.arange(len(place)) % 2, 1.0, -1.0)[:, None]  # both signs occur
        return named | {f"tcp_q{axis}": turned[:, k] for k, axis in enumerate("xyzw")}
    angles = np.array([rpy_from_rotation(one) for one in rotation])
    return named | {f"tcp_{axis}": angles[:, k] for k, axis in enumerate(("roll", "pitch", "yaw"))}


BASES = {
    "upright": np.eye(3),
    "downward": np.diag([1.0, -1.0, -1.0]),
    "x upward": rotation_from_rpy(np.array([0.0, -np.pi / 2, 0.0])),
    "y upward": rotation_from_rpy(np.array([np.pi / 2, 0.0, 0.0])),
    "half a turn": np.diag([-1.0, -1.0, 1.0]),
}


@pytest.mark.parametrize("form", ["matrix", "quaternion", "rpy"])
@pytest.mark.parametrize("base", BASES)
def test_coordinates_carry_the_frame_to_its_poses(base, form):
    place, rotation = poses(BASES[base])
    (found,) = frame_poses(columns(place, rotation, form), "poses.csv")
    coordinates = found.coordinates
    names = tuple(coordinates)
    assert frame_of(names) == found.name
    assert all(np.ptp(values) < 3.0 for values in coordinates.values())  # no leap by a turn
    chain = chain_between(frame_robot(found.name, names), BASE, found.name)
    there = chain.over(names).at(np.column_stack(list(coordinates.values())))
    np.testing.assert_allclose(there.place, place, atol=1e-12)
    np.testing.assert_allclose(there.rotation, rotation, atol=1e-9)


def test_logs_of_one_robot_have_the_same_turns():
    """About half a turn, rounding decides on which side a mean is."""
    for base in BASES.values():
        first, second = (
            frame_poses(columns(*poses(base, seed=seed), "matrix"), "")[0].coordinates for seed in (1, 2)
        )
        assert list(first) == list(second)
        assert all(abs(first[name].mean() - second[name].mean()) < 1.0 for name in first)


def test_other_columns_are_no_frame():
    place, rotation = poses(np.eye(3))
    whole = columns(place, rotation, "matrix")
    assert not frame_poses({name: values for name, values in whole.items() if name != "O_T_EE_12"}, "")
    assert not frame_poses({"leica_x": place[:, 0], "leica_y": place[:, 1], "leica_z": place[:, 2]}, "")
    assert frame_of(("pan", "lift")) is None and frame_of(()) is None


def test_wrong_poses_are_named():
    place, rotation = poses(np.eye(3))
    with pytest.raises(LogError, match=r"t.csv: O_T_EE: a coordinate of its place is .*; possible: m, not mm"):
        frame_poses(columns(1000.0 * place, rotation, "matrix"), "t.csv")
    with pytest.raises(LogError, match="row 3: the matrix of O_T_EE is no rotation"):
        bad = rotation.copy()
        bad[2] *= 1.1
        frame_poses(columns(place, bad, "matrix"), "t.csv")
    with pytest.raises(LogError, match="quaternion of tcp has the length 2; possible: 1"):
        doubled = columns(place, rotation, "quaternion")
        frame_poses({n: 2 * v if "_q" in n else v for n, v in doubled.items()}, "t.csv")
    with pytest.raises(LogError, match="possible: rad, at most a turn"):
        angles = columns(place, rotation, "rpy")
        frame_poses({n: np.degrees(v) if n[-1] in "lhw" else v for n, v in angles.items()}, "t.csv")


def table(tmp_path, numbers):
    path = tmp_path / "poses.csv"
    rows = np.column_stack(list(numbers.values()))
    path.write_text("\n".join([",".join(numbers), *(",".join(map(repr, row.tolist())) for row in rows)]) + "\n")
    return path


def test_poses_stand_for_joints_only_where_there_are_none(tmp_path):
    place, rotation = poses(np.eye(3))
    whole = columns(place, rotation, "matrix")
    with open_log(table(tmp_path, whole)) as log:
        notes = " ".join(one.text for one in log.findings)
    assert "O_T_EE: a pose in each row" in notes
    assert "joints: O_T_EE.x, O_T_EE.y, O_T_EE.z, O_T_EE.rz, O_T_EE.ry, O_T_EE.rx" in notes
    with open_log(table(tmp_path, {"pan": place[:, 0], **whole})) as log:
        notes = " ".join(one.text for one in log.findings)
    assert "joints: pan" in notes and "columns not used: O_T_EE_00" in notes


def test_columns_beyond_the_urdf_are_no_joints():
    t = np.arange(3.0)
    joints = Series(t, np.arange(9.0).reshape(3, 3), ("pan", "humidity", "lift"), "rad", t.astype(np.int64))
    found = Features(joints, {}, None, (), (), {}, poses=True)
    robot = Robotics(urdf.parse_urdf(ARM, "arm.urdf"), {}, 0.1)
    (kept,), findings = joints_of_urdf([found], robot)
    assert kept.joints.names == ("pan", "lift")
    np.testing.assert_array_equal(kept.joints.values, joints.values[:, [0, 2]])
    assert findings[0].text == "arm.urdf: these columns are not in it, so they are no joints: humidity"
    moving = replace(found, poses=False)
    (untouched,), findings = joints_of_urdf([moving], robot)
    assert set(untouched.joints.names) == set(joints.names) and not findings  # a log's joints are joints

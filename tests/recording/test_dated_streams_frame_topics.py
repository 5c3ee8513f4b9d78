"""Poses of a frame in topics and tf stand for joints: the chain of the six coordinates has the pose again."""

import numpy as np
import pytest

from bodylog.errors import LogError
from bodylog.kinematics.chain import chain_between
from bodylog.kinematics.frame_robot import frame_robot
from bodylog.kinematics.rotations import quaternions_from_rotations, rotation_from_vector
from bodylog.recording.recording import read_recording
from bodylog.settings import Settings, TopicSettings
from bodylog.sim import messages
from tests.logs.writing import T0, Stream, write

COUNT = 40
MS = 10**6
TF = """/tf.transforms[:]{child_frame_id=="tool0"}.transform"""


@pytest.fixture(scope="module")
def poses():
    """Places (N,3) m and rotations (N,3,3) of a hand that points down and turns past half a turn."""
    s = np.linspace(0.0, 1.0, COUNT)
    down = rotation_from_vector(np.array([np.pi, 0.0, 0.0]))
    turns = np.stack(
        [rotation_from_vector(np.array([0.3 * x, 0.2, 2.5 + 1.5 * x])) @ down for x in s]
    )
    return np.column_stack([0.4 + 0.1 * s, 0.2 * s, 0.3 - 0.1 * s]), turns


@pytest.fixture(scope="module")
def log(poses, tmp_path_factory):
    """A log with the poses as PoseStamped, and in tf among other frames, in every second message."""
    place, turn = poses
    quaternions = quaternions_from_rotations(turn)
    encode = messages.type_store().serialize_cdr
    stamped, moved = [], []
    for k in range(COUNT):
        ns = T0 + k * 20 * MS
        quaternion = quaternions[k] if k != 7 else np.zeros(4)  # a message without a rotation
        message = messages.pose_message(ns, place[k], quaternion)
        stamped.append((ns, bytes(encode(message, message.__msgtype__))))
        frames = [("elbow", np.zeros(3), np.array([0, 0, 0, 1.0]))]
        frames += [("tool0", place[k], quaternions[k])] if k % 2 == 0 else []
        message = messages.transforms_message(ns, frames, "base")
        moved.append((ns, bytes(encode(message, message.__msgtype__))))
    kinds = (
        ("/hand/pose", "geometry_msgs/msg/PoseStamped", stamped),
        ("/tf", "tf2_msgs/msg/TFMessage", moved),
    )
    streams = [
        Stream(name, kind, messages.message_definition(kind), found) for name, kind, found in kinds
    ]
    return write(tmp_path_factory.mktemp("poses") / "poses.mcap", streams)


@pytest.mark.parametrize(
    ("source", "frame", "rows"),
    [
        ("/hand/pose", "hand/pose", [k for k in range(COUNT) if k != 7]),
        (TF, "tool0", list(range(0, COUNT, 2))),
    ],
)
def test_coordinates_carry_the_frame_to_its_poses(log, poses, source, frame, rows):
    found = read_recording(log, Settings(topics=TopicSettings(joints=source)))
    assert found.signals.joints.unit == "rad" and found.signals.joints.names[:3] == (
        f"{frame}.x",
        f"{frame}.y",
        f"{frame}.z",
    )
    assert (
        np.abs(np.diff(found.signals.joints.values, axis=0)).max() < 1.0
    )  # no leap where an angle passes half a turn
    there = chain_between(frame_robot(frame, found.signals.joints.names), "base", frame).at(
        found.signals.joints.values
    )
    np.testing.assert_allclose(there.place, poses[0][rows], atol=1e-9)
    np.testing.assert_allclose(there.rotation, poses[1][rows], atol=1e-9)
    lost = found.facts.health[source.partition(".")[0]].rejected
    assert sum(lost.values()) == COUNT - len(rows) and len(lost) == 1


def test_tf_alone_asks_which_frame_and_a_log_without_joints_names_the_poses(log):
    with pytest.raises(
        LogError, match=r"holds the poses of several frames; say which: .*child_frame_id"
    ):
        read_recording(log, Settings(topics=TopicSettings(joints="/tf")))
    found = read_recording(log, Settings())
    assert any('[topics] joints = "/hand/pose"' in one.text for one in found.facts.findings)


def test_the_line_that_info_prints_is_read_again(log):
    first = read_recording(log, Settings(topics=TopicSettings(joints="/hand/pose")))
    again = read_recording(log, Settings(topics=TopicSettings(joints=first.facts.roles["joints"])))
    np.testing.assert_array_equal(again.signals.joints.values, first.signals.joints.values)

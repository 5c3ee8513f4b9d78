"""Points in space of topics and of tables beside a log: their frame, unit and standard deviations."""

import numpy as np
import pytest

from bodylog import logs
from bodylog.errors import ConfigError, LogError
from bodylog.recording.recording import read_recording
from bodylog.settings import Settings
from bodylog.sources import TableSource, TopicSource, parse_source

START_NS = 10**18
T = np.arange(20) * 0.1
NS = START_NS + np.rint(T * 1e9).astype(np.int64)
POINTS_M = np.column_stack([0.1 + 0.3 * np.sin(T), 0.2 * T, 1.0 - 0.1 * T])
"""Along a path of less than a metre."""


def write_log(path, kind="geometry_msgs/msg/PointStamped", field="point", scale=1.0):
    """A log of one joint and of a point in space."""
    places = {f"{field}.{axis}": scale * POINTS_M[:, k] for k, axis in enumerate("xyz")}
    with logs.Writer(path) as out:
        joint = {"header.stamp": NS, "name": [["pan"]] * len(NS), "position": np.sin(T)[:, None]}
        out.write("/joint_states", "sensor_msgs/msg/JointState", NS, joint)
        out.write("/mocap", kind, NS, {"header.stamp": NS, "header.frame_id": "world", **places})
    return path


def read_track(path, source, name="world/ball"):
    recording = read_recording(path, Settings(features={"ball": source}))
    return recording.signals.tracks[name], [one.text for one in recording.facts.findings]


@pytest.mark.parametrize(
    ("kind", "field"),
    [
        ("geometry_msgs/msg/PointStamped", "point"),
        ("geometry_msgs/msg/PoseStamped", "pose.position"),
        ("geometry_msgs/msg/TransformStamped", "transform.translation"),
    ],
)
def test_topic_in_a_frame_is_a_track_of_its_tracker(tmp_path, kind, field):
    path = write_log(tmp_path / "log.mcap", kind, field)
    track, _ = read_track(path, TopicSource("/mocap", frame="world"))
    assert (track.names, track.unit) == (("x", "y", "z"), "mm")
    np.testing.assert_allclose(track.values, 1e3 * POINTS_M)


def test_topic_in_millimetres_is_recognised(tmp_path):
    path = write_log(tmp_path / "log.mcap", scale=1e3)
    track, texts = read_track(path, TopicSource("/mocap", frame="world"))
    np.testing.assert_allclose(track.values, 1e3 * POINTS_M)
    assert any("world/ball: points that span" in text and "in mm" in text for text in texts)


def test_topic_without_a_frame_is_in_images(tmp_path):
    track, _ = read_track(write_log(tmp_path / "log.mcap"), TopicSource("/mocap"), "ball")
    assert track.unit == "px" and track.values.shape == (len(T), 2)


@pytest.mark.parametrize(("deviations", "width"), [("ball_sigma", 1), ("ball_std_x,ball_std_y,ball_std_z", 3)])
def test_table_beside_a_log_has_points_and_deviations(tmp_path, deviations, width):
    path = write_log(tmp_path / "log.mcap")
    rows = np.column_stack([T, POINTS_M, np.full((len(T), width), 2e-4)])
    np.savetxt(tmp_path / "mocap.csv", rows, delimiter=",", header=f"t,ball_x,ball_y,ball_z,{deviations}", comments="")
    track, _ = read_track(path, TableSource("mocap.csv", frame="world"))
    np.testing.assert_allclose(track.values, 1e3 * POINTS_M)
    np.testing.assert_allclose(track.std, 0.2)


def test_what_lacks_an_axis_is_refused_by_name(tmp_path):
    path = write_log(tmp_path / "log.mcap")
    np.savetxt(tmp_path / "mocap.csv", np.column_stack([T, POINTS_M[:, :2]]), delimiter=",", header="t,ball_x,ball_y", comments="")
    with pytest.raises(ConfigError, match="no column of numbers 'ball_z'"):
        read_track(path, TableSource("mocap.csv", frame="world"))
    with pytest.raises(ConfigError, match="x and y and z"):
        read_track(path, TableSource("mocap.csv", ("ball_x", "ball_y"), "world"))
    with pytest.raises(ConfigError, match="it must lead to x, y and z"):
        read_track(path, TopicSource("/joint_states", frame="world"))
    with pytest.raises(LogError, match="no topic '/mocup'"):
        read_track(path, TopicSource("/mocup", frame="world"))


def test_frame_is_read_from_toml():
    source = parse_source("ball", {"topic": "/mocap", "frame": "world"}, "robot.toml")
    assert source == TopicSource("/mocap", None, "world")

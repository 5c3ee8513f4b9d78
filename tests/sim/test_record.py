import sys

import numpy as np
import pytest
from mcap.reader import make_reader
from pybag.mcap_reader import McapFileReader

from bodylog.errors import UsageError
from bodylog.sim import record_scenario
from bodylog.sim.arms import ARMS
from bodylog.sim.stage import START_NS

from . import reading

pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")

SMALL = {"size": (160, 120)}


@pytest.fixture(scope="module")
def touch(tmp_path_factory):
    path = tmp_path_factory.mktemp("record") / "touch.mcap"
    record_scenario("touch", path, seed=4, duration=6.0, **SMALL)
    return path


@pytest.fixture(scope="module")
def topics(touch):
    return reading.read(touch)


def test_all_topics_with_their_types_and_rates(topics):
    counts = {topic: (rows[0].message.__msgtype__, len(rows)) for topic, rows in topics.items()}
    hands = counts.pop("/truth/hand_pixel")
    assert hands[0] == "geometry_msgs/msg/PointStamped" and 20 < hands[1] < 120
    assert counts == {
        "/robot_description": ("std_msgs/msg/String", 1),
        "/joint_states": ("sensor_msgs/msg/JointState", 600),
        "/truth/joint_states": ("sensor_msgs/msg/JointState", 600),
        "/skin": ("bodylog_msgs/msg/SkinArray", 600),
        "/camera/image/compressed": ("sensor_msgs/msg/CompressedImage", 120),
        "/camera/camera_info": ("sensor_msgs/msg/CameraInfo", 120),
        "/tf": ("tf2_msgs/msg/TFMessage", 120),
        "/truth/effector_pose": ("geometry_msgs/msg/PoseStamped", 120),
        "/truth/effector_pixel": ("geometry_msgs/msg/PointStamped", 120),
        "/truth/touch": ("bodylog_msgs/msg/Touch", 1),
        "/truth/stroke": ("bodylog_msgs/msg/Stroke", 1),
    }


def test_other_readers_see_every_message(touch, topics):
    with touch.open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        messages = list(reader.iter_messages())
    assert len(messages) == sum(len(rows) for rows in topics.values())
    assert all(schema.encoding == "ros2msg" and channel.message_encoding == "cdr" for schema, channel, _ in messages)
    times = [message.log_time for _, _, message in messages]
    assert times == sorted(times)
    with McapFileReader.from_file(touch) as bag:
        for topic, rows in topics.items():
            seen = list(bag.messages(topic))
            assert [message.log_time for message in seen] == [row.log_ns for row in rows], topic
            assert topic != "/skin" or np.array_equal(seen[5].data.data, rows[5].message.data)


def test_messages_are_logged_a_few_ms_after_their_stamp(topics):
    for topic, rows in topics.items():
        if topic not in ("/robot_description", "/truth/touch", "/truth/stroke"):
            late = np.array([row.log_ns - START_NS - row.t * 1e9 for row in rows]) / 1e6
            assert late.min() >= 1.9 and late.max() <= 14.1, topic


def test_same_arguments_same_bytes(touch, tmp_path):
    record_scenario("touch", tmp_path / "again.mcap", seed=4, duration=6.0, **SMALL)
    assert (tmp_path / "again.mcap").read_bytes() == touch.read_bytes()


def test_seeds_differ(tmp_path):
    paths = []
    for seed in (0, 1):
        record_scenario("reach", tmp_path / f"{seed}.mcap", seed=seed, duration=0.5, **SMALL)
        paths.append(reading.positions(reading.read(tmp_path / f"{seed}.mcap"), "/truth/joint_states")[1])
    assert np.abs(paths[0] - paths[1]).max() > 0.05


def test_encoders_are_alphabetical_true_and_as_noisy_as_asked(tmp_path):
    record_scenario("reach", tmp_path / "a.mcap", duration=4.0, noise=0.05, **SMALL)
    topics = reading.read(tmp_path / "a.mcap")
    t, read, names = reading.positions(topics, "/joint_states")
    true_t, truth, true_names = reading.positions(topics, "/truth/joint_states")
    assert names == sorted(names) and true_names == list(ARMS["ur5"].joints)
    np.testing.assert_array_equal(t, true_t)
    errors = read - truth[:, [true_names.index(name) for name in names]]
    np.testing.assert_allclose(errors.std(0), 0.05, rtol=0.15)
    assert np.abs(errors.mean(0)).max() < 0.01
    assert all(np.isfinite(row.message.velocity).all() for row in topics["/joint_states"])


@pytest.mark.parametrize("arm", ARMS)
def test_pose_pixel_camera_info_and_tf_agree(arm, tmp_path):
    record_scenario("babble", tmp_path / "a.mcap", duration=1.0, arm=arm, full=True, **SMALL)
    topics = reading.read(tmp_path / "a.mcap")
    info = topics["/camera/camera_info"][0].message
    k, frames = info.k.reshape(3, 3), {row.t: row.message for row in topics["/tf"]}
    assert (info.width, info.height) == (160, 120)
    for row in topics["/truth/effector_pose"]:
        place = {frame.child_frame_id: frame.transform for frame in frames[row.t].transforms}
        position, translation = row.message.pose.position, place["effector"].translation
        assert [getattr(position, axis) for axis in "xyz"] == [getattr(translation, axis) for axis in "xyz"]
    seen = reading.pixels(topics, "/truth/effector_pixel")
    assert len(seen) >= 15
    camera = place["camera_optical_frame"]
    for row in topics["/truth/effector_pose"]:
        if row.t in seen:
            p = row.message.pose.position
            local = _inverse(camera, np.array([p.x, p.y, p.z]))
            projected = (k @ local / local[2])[:2]
            assert np.linalg.norm(projected - seen[row.t]) < 0.1


def _inverse(transform, point):
    x, y, z, w = (getattr(transform.rotation, axis) for axis in "xyzw")
    translation = np.array([getattr(transform.translation, axis) for axis in "xyz"])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return (np.eye(3) + 2 * w * cross + 2 * cross @ cross).T @ (point - translation)


def test_raw_and_jpeg_show_the_same(tmp_path):
    for image in ("raw", "jpeg"):
        record_scenario("reach", tmp_path / f"{image}.mcap", duration=0.2, image=image, **SMALL)
    raw, jpeg = (reading.pictures(reading.read(tmp_path / f"{image}.mcap")) for image in ("raw", "jpeg"))
    assert [t for t, _ in raw] == [t for t, _ in jpeg]
    for (_, one), (_, other) in zip(raw, jpeg, strict=True):
        assert np.abs(one.astype(int) - other).mean() < 4


def test_progress_counts_pictures(tmp_path):
    counts = []
    record_scenario("reach", tmp_path / "a.mcap", duration=0.5, progress=counts.append, **SMALL)
    assert counts == [1] * 10


@pytest.mark.parametrize(
    "wrong, words",
    [
        ({"scenario": "reech"}, "scenario 'reech' is not known; possible: babble,.*nearest: reach"),
        ({"variant": "latte"}, "variant 'latte' is not known; possible: synchronous, late,.*nearest: late"),
        ({"place": "left"}, "scenario touch: it has no places"),
        ({"arm": "ur55"}, "arm 'ur55' is not known; possible: ur5, seven; nearest: ur5"),
        ({"image": "png"}, "image 'png' is not known; possible: jpeg, raw"),
        ({"duration": -1.0}, "duration is -1.0; possible: 0.1 to"),
        ({"duration": float("nan")}, "duration is nan"),
        ({"noise": -0.1}, "noise is -0.1"),
        ({"size": (8, 8)}, "width is 8; possible: 64 to 4096"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_record_names_impossible_options(tmp_path, wrong, words):
    arguments = {"scenario": "touch", "out": tmp_path / "x.mcap", **wrong}
    with pytest.raises(UsageError, match=words) as caught:
        record_scenario(**arguments)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_record_without_pybullet_leaves_no_output(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(UsageError, match=r"bodylog\[sim\]"):
        record_scenario("reach", tmp_path / "x.mcap")
    assert not list(tmp_path.iterdir())

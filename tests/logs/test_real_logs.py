"""Logs of other people's recorders: none crashes, and decoded values equal those of rosbags."""

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bodylog.errors import BodylogError
from bodylog.logs.decode.columns import definition_of, read_topic_columns
from bodylog.logs.decode.definitions import PRIMITIVES, TEXTS, TIMES, Definition
from bodylog.logs.decode.parts import TopicColumns
from bodylog.logs.formats import open_log, payload_views
from bodylog.logs.images.messages import COMPRESSED, RAW, make_image_decoder
from bodylog.recording.facts import describe_log
from bodylog.recording.recording import read_recording
from bodylog.settings import Settings
from bodylog.types import Topic

LOGS = Path(__file__).parents[2].parent / "shared" / "logs"
pytestmark = pytest.mark.skipif(not LOGS.is_dir(), reason="the recorded logs (../shared/logs) are not at hand")


def listed() -> list[str]:
    if not LOGS.is_dir():
        return []
    with (LOGS / "INDEX.csv").open() as table:
        return [row["file"] for row in csv.DictReader(table)]


CALIBRATION = "mikeferguson__robot_calibration/_hist/e72fba5d/launch"
FILES = [name for name in listed() if not name.startswith("foxglove__mcap/")]
CONFORMANCE = [name for name in listed() if name.startswith("foxglove__mcap/")]


@pytest.mark.parametrize("name", FILES)
def test_info_gives_facts_or_one_line(name):
    try:
        found = describe_log(LOGS / name, Settings())
    except BodylogError as error:
        assert str(error).startswith(str(LOGS / name)) and "\n" not in str(error)
    else:
        assert all("\n" not in finding["text"] for finding in found["findings"])
        assert found["duration_s"] >= 0


def test_info_of_the_conformance_files():
    for name in CONFORMANCE:
        assert describe_log(LOGS / name, Settings())["joints"] == []


@pytest.mark.parametrize(
    ("name", "topic", "count", "first"),
    [
        ("ipab-slmc__kuka_honeypot_demo/data/test.bag", "/joint_states", 7, "lwr_arm_0_joint"),
        ("vbarcena2020__abitobot/rosbag/rosbag2_2025_05_09-18_01_02_0.mcap", "/joint_states", 10, "arm_1_link_joint"),
        ("archebase__robocodec/tests/fixtures/robocodec_test_1.mcap", "io_teleop/joint_states", 9, None),
        ("archebase__robocodec/tests/fixtures/robocodec_test_10.mcap", "io_teleop/joint_states", 6, None),
        ("archebase__robocodec/tests/fixtures/robocodec_test_8.mcap", "/io_teleop/joint_states", 7, None),
        (f"{CALIBRATION}/calibration_poses.bag", "calibration_joint_states", 15, None),
    ],
)
def test_info_finds_joints(name, topic, count, first):
    found = describe_log(LOGS / name, Settings())
    assert (found["roles"]["joints"], len(found["joints"])) == (topic, count)
    assert first is None or found["joints"][0] == first


def test_read_handles_simulated_stamps():
    got = read_recording(LOGS / "vbarcena2020__abitobot/rosbag/rosbag2_2025_05_09-18_01_02_0.mcap", Settings())
    assert got.signals.joints is not None
    assert (got.signals.joints.values.shape, got.start_ns) == ((1866, 10), 101_550_000_000)
    np.testing.assert_allclose(np.diff(got.signals.joints.t), 0.05, atol=1e-9)


PICTURES = {
    "AIT-Assistive-Autonomous-Systems__ros2bag_tools/_hist/3b3310a7/ros2bag_tools/test/images.bag/images.bag_0.db3": 3,
    "UbiquityRobotics__fiducials/fiducial_slam/test/aruco_images.bag": 1,
    "archebase__robocodec/tests/fixtures/robocodec_test_1.mcap": 2,
    "archebase__robocodec/tests/fixtures/robocodec_test_10.mcap": 2,
    "archebase__robocodec/tests/fixtures/robocodec_test_8.mcap": 3,
    "eric-wieser__ros_numpy/_hist/254dbc37/test/test.bag": 2,
    "gagalo123__mcap-explorer/examples/demo.mcap": 30,
    "klintan__rosbag2.js/examples/sample.db3": 2,
    "rosbag-sharing-community__amber/tests/rosbag/soccer_goal/soccer_goal_12.mcap": 2,
}
"""Files with pictures -> how many; three more hold placeholders of 30 bytes that claim 640 x 480."""


def pictures(name: str) -> Iterator[tuple[Topic, bytes]]:
    with open_log(LOGS / name) as log:
        for topic in log.topics:
            if topic.type in COMPRESSED + RAW:
                yield from ((topic, bytes(p)) for batch in log.batches([topic.id]) for p in payload_views(batch))


def test_decoder_decodes_every_image_at_every_scale():
    for name, count in PICTURES.items():
        found = list(pictures(name))
        assert len(found) == count, name
        for topic, payload in found:
            whole = make_image_decoder(topic)(payload, 1)
            for k in (2, 4, 8):
                assert make_image_decoder(topic)(payload, k).shape == (-(-whole.shape[0] // k), -(-whole.shape[1] // k), 3)


def test_image_files_are_all_listed():
    seen = set()
    for name in FILES:
        try:
            found = list(pictures(name))
        except BodylogError:
            continue
        seen |= {name} if found else set()
    placeholders = {name for name in seen if "robocodec_test_14" in name or "geocamxyz" in name}
    assert seen - placeholders == set(PICTURES)


def test_frames_show_the_moving_disc():
    got = read_recording(LOGS / "gagalo123__mcap-explorer/examples/demo.mcap", Settings())
    assert got.cameras.frames is not None
    places = []
    for frame in got.cameras.frames():
        b, g, r = frame.image.astype(int).transpose(2, 0, 1)
        yellow = (np.minimum(r, g) - b) > 80
        assert yellow.sum() > 50
        places.append(np.argwhere(yellow).mean(axis=0))
    assert len(places) == 30
    assert np.ptp(np.array(places), axis=0).max() > 20


# Every field of every topic against rosbags, a few messages each.


def leaves(definition: Definition, type_: str, above: str = "") -> Iterator[str]:
    for field in definition.types[type_]:
        here = above + field.name
        if field.type in PRIMITIVES or field.type in TEXTS or field.type in TIMES:
            yield here
        else:
            yield from leaves(definition, field.type, f"{here}{'' if field.size is None else '[:]'}.")


def flat(held: Any, path: str) -> Sequence[Any] | np.ndarray:
    if not path:
        if isinstance(held, np.ndarray) and held.dtype != object:
            return held
        items = held if isinstance(held, list | np.ndarray) else [held]
        return [x.sec * 10**9 + x.nanosec if hasattr(x, "nanosec") else x for x in items]
    first, _, rest = path.partition(".")
    inner = getattr(held, first.removesuffix("[:]"))
    if not first.endswith("[:]"):
        return flat(inner, rest)
    return [x for item in inner for x in flat(item, rest)]


def typestore(topic: Topic) -> Any:
    if not topic.definition.strip():
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(topic.definition.decode(), topic.type))
    return store


def comparable() -> list[tuple[str, Topic]]:
    found, seen = [], set()
    for name in FILES:
        try:
            with open_log(LOGS / name) as log:
                topics = log.topics
        except BodylogError:
            continue
        for topic in topics:
            key = (topic.type, topic.definition, topic.encoding)
            if topic.messages and topic.encoding in ("cdr", "ros1") and key not in seen:
                seen.add(key)
                found.append((name, topic))
    return found


def compare(got: TopicColumns, messages: dict[int, Any], fields: list[str]) -> None:
    assert set(messages) <= set(got.sound.tolist()), got.rejected
    for part in got.parts:
        for place, row in enumerate(part.rows.tolist()):
            if row not in messages:
                continue
            for path, values in zip(fields, part.values, strict=True):
                want = flat(messages[row], path)
                have = list(values) if isinstance(values, tuple) else np.atleast_1d(values[place])
                np.testing.assert_array_equal(have, np.array(want, getattr(have, "dtype", None)), err_msg=path)


def check_topic(name: str, topic: Topic) -> int:
    """How many messages of a topic were compared; 0 if rosbags cannot read it."""
    with open_log(LOGS / name) as log:
        raw = [bytes(p) for batch in log.batches([topic.id]) for p in payload_views(batch)]
        try:
            store = typestore(topic)
            decode = store.deserialize_ros1 if topic.encoding == "ros1" else store.deserialize_cdr
            chosen = sorted({0, 1, 2, len(raw) // 2, len(raw) - 1} & set(range(len(raw))))
            messages = {row: decode(raw[row], topic.type) for row in chosen}
        except Exception:
            return 0
        definition = definition_of(topic)
        fields = list(leaves(definition, definition.root))
        compare(read_topic_columns(log, topic, fields), messages, fields)
        return len(messages)


def test_columns_equal_rosbags_for_every_field():
    topics = comparable()
    checked = {(name, topic.name): check_topic(name, topic) for name, topic in topics}
    silent = sorted(f"{name} {topic}" for (name, topic), count in checked.items() if not count)
    assert len(checked) - len(silent) >= 170
    assert len(silent) <= 19, silent


def test_read_is_the_same_in_three_containers():
    bag, rosbag2 = (read_recording(LOGS / "arm" / name, Settings()) for name in ("reach.bag", "reach_rosbag2"))
    assert (bag.start_ns, bag.duration_s) == (rosbag2.start_ns, rosbag2.duration_s)
    for role in ("joints", "skin", "truth"):
        one, other = getattr(bag.signals, role), getattr(rosbag2.signals, role)
        np.testing.assert_array_equal(one.t, other.t)
        np.testing.assert_array_equal(one.values, other.values)
        assert (one.names, one.unit) == (other.names, other.unit)
    assert bag.cameras.frames is not None and rosbag2.cameras.frames is not None
    for one, other in zip(bag.cameras.frames(), rosbag2.cameras.frames(), strict=True):
        assert one.t == other.t
        np.testing.assert_array_equal(one.image, other.image)


@pytest.mark.parametrize("name", ["explore.mcap", "reach.mcap", "reach.bag", "drift.mcap", "touch.mcap"])
def test_read_gives_the_published_arm_positions(name):
    got = read_recording(LOGS / "arm" / name, Settings())
    made = np.load(LOGS / "arm" / f"{name}.truth.npz")
    assert got.signals.joints is not None and got.signals.truth is not None
    assert got.cameras.frames is not None and got.signals.skin is not None
    assert sorted(got.signals.joints.names) == sorted(got.signals.truth.names)
    order = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    truth = got.signals.truth.values[:, [got.signals.truth.names.index(f"{joint}_joint") for joint in order]]
    np.testing.assert_allclose(truth, made["q"], atol=1e-9)
    np.testing.assert_allclose(got.signals.truth.t, made["t"] - made["t"][0], atol=2e-9)
    np.testing.assert_allclose([frame.t for frame in got.cameras.frames()], made["tf"] - made["t"][0], atol=2e-9)
    assert got.signals.skin.values.shape[1] == 117
    assert all(not health.rejected for health in got.facts.health.values())

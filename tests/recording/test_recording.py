"""Whole recordings from small logs: joints by name, time, health, frames in order, and one-line errors."""

import contextlib
import json
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bodylog.errors import BodylogError, ConfigError, FormatError, LogError
from bodylog.logs.mcap import reader
from bodylog.recording.facts import describe_log
from bodylog.recording.recording import read_recording
from bodylog.settings import BodySettings, Settings, TimeSettings, TopicSettings
from bodylog.types import LazyImage
from tests.logs.writing import (
    T0,
    Stream,
    camera,
    cdr,
    compressed,
    define,
    header,
    joint_state,
    joints,
    register,
    write,
)

MS = 1_000_000
NAMES = ("shoulder", "elbow", "wrist")
PLAIN = Settings()


def moves(n: int, names: tuple[str, ...] = NAMES, start: int = T0, every: int = 20 * MS) -> list[tuple[int, bytes]]:
    """n joint messages whose joint j of NAMES is at n + j/10, logged 4 ms after their stamp."""
    angle = {name: index / 10 for index, name in enumerate(NAMES)}
    held = [[i + angle.get(name, 9.0) for name in names] for i in range(n)]
    stamps = [start + i * every for i in range(n)]
    return [(t + 4 * MS, joint_state(t, names, row)) for t, row in zip(stamps, held, strict=True)]


def arrays(topic: str, rows: np.ndarray, start: int = T0, every: int = 10 * MS) -> Stream:
    kind = "std_msgs/msg/Float32MultiArray"
    layout = ("std_msgs/msg/MultiArrayLayout", {"dim": [], "data_offset": 0})
    payloads = [cdr(kind, layout=layout, data=row.astype(np.float32)) for row in rows]
    messages = [(start + i * every, payload) for i, payload in enumerate(payloads)]
    return Stream(topic, kind, define(kind), messages)


def settings(**sections: Any) -> Settings:
    return replace(PLAIN, **sections)


def test_read_uses_header_or_log_time(tmp_path):
    skin = np.linspace(0, 1, 60).reshape(20, 3)
    log = write(tmp_path / "a.mcap", [joints("/joint_states", moves(10)), arrays("/skin", skin)])
    got = read_recording(log, PLAIN)
    assert (got.facts.name, got.facts.format, got.start_ns) == ("a.mcap", "mcap", T0)
    assert got.signals.joints is not None and got.signals.skin is not None
    assert got.signals.truth is None and got.cameras.frames is None
    np.testing.assert_array_equal(got.signals.joints.t, np.arange(10) * 20 * MS / 1e9)
    np.testing.assert_array_equal(got.signals.joints.source_ns, T0 + 4 * MS + 20 * MS * np.arange(10))
    np.testing.assert_array_equal(got.signals.joints.values, np.arange(10.0)[:, None] + [0, 0.1, 0.2])
    assert (got.signals.joints.names, got.signals.joints.unit) == (NAMES, "rad")
    np.testing.assert_array_equal(got.signals.skin.t, np.arange(20) * 10 * MS / 1e9)
    np.testing.assert_array_equal(got.signals.skin.values, skin.astype(np.float32))
    assert got.duration_s == pytest.approx(0.19)
    assert got.facts.roles == {"joints": "/joint_states", "skin": "/skin.data"}


def test_read_orders_joints_by_name(tmp_path):
    turned = moves(10, ("elbow", "wrist", "shoulder"))
    log = write(tmp_path / "a.mcap", [joints("/j", [*moves(10)[:5], *turned[5:]])])
    got = read_recording(log, PLAIN).signals.joints
    assert got is not None and got.names == NAMES
    np.testing.assert_allclose(got.values, np.arange(10.0)[:, None] + [0, 0.1, 0.2], atol=1e-15)
    chosen = read_recording(log, settings(body=BodySettings(joints=("wrist", "shoulder")))).signals.joints
    assert chosen is not None and chosen.names == ("wrist", "shoulder")
    np.testing.assert_allclose(chosen.values, np.arange(10.0)[:, None] + [0.2, 0], atol=1e-15)


def test_read_prefers_the_arm_to_its_gripper(tmp_path):
    log = write(tmp_path / "a.mcap", [joints("/a_gripper", moves(12, ("finger",))), joints("/arm", moves(10))])
    assert read_recording(log, PLAIN).facts.roles == {"joints": "/arm", "joints/a_gripper": "/a_gripper"}


def test_read_merges_joints_of_equal_stamps(tmp_path):
    arm, hand = ("shoulder", "elbow"), ("wrist",)
    alternating = [(arm, hand)[i % 2] for i in range(6)]
    rows = [m for i, names in enumerate(alternating) for m in moves(6, names)[i : i + 1]]
    got = read_recording(write(tmp_path / "a.mcap", [joints("/j", rows)]), PLAIN)
    assert got.signals.joints is not None and got.signals.joints.names == NAMES
    np.testing.assert_array_equal(np.isnan(got.signals.joints.values[:, 2]), [True, False] * 3)
    both = [m for pair in zip(moves(6, arm), moves(6, hand), strict=True) for m in pair]
    got = read_recording(write(tmp_path / "b.mcap", [joints("/j", both)]), PLAIN)
    assert got.signals.joints is not None and not np.isnan(got.signals.joints.values).any()
    assert len(got.signals.joints.t) == 6
    assert (got.facts.health["/j"].seen, got.facts.health["/j"].used) == (12, 12)


def test_read_needs_names_for_nameless_joints(tmp_path):
    rows = [(t, joint_state(t, (), (1.0, 2.0, 3.0))) for t, _ in moves(4)]
    log = write(tmp_path / "a.mcap", [joints("/j", rows)])
    with pytest.raises(LogError, match=r"a.mcap: /j: the 3 joints have no names; type in robot.toml: \[body\] joints"):
        read_recording(log, PLAIN)
    with pytest.raises(LogError, match="names 2; name all 3"):
        read_recording(log, settings(body=BodySettings(joints=("a", "b"))))
    got = read_recording(log, settings(body=BodySettings(joints=NAMES))).signals.joints
    assert got is not None and got.names == NAMES
    assert got.values.tolist() == [[1, 2, 3]] * 4
    wanted = describe_log(log, PLAIN)
    assert wanted["roles"] == {"joints": "/j"}
    assert wanted["joints"] == [] and any("have no names" in f["text"] for f in wanted["findings"])


def test_read_lists_joints_for_an_unknown_one(tmp_path):
    log = write(tmp_path / "a.mcap", [joints("/j", moves(3))])
    with pytest.raises(LogError, match="'knee'; the log has elbow, shoulder, wrist"):
        read_recording(log, settings(body=BodySettings(joints=("elbow", "knee"))))


def test_read_converts_degrees(tmp_path):
    truth = [(t, joint_state(t, NAMES, (90.0, 0.0, -180.0))) for t, _ in moves(3)]
    log = write(tmp_path / "a.mcap", [joints("/j", truth), joints("/truth", truth)])
    got = read_recording(log, settings(body=BodySettings(unit="deg")))
    assert got.signals.joints is not None and got.signals.truth is not None
    np.testing.assert_allclose(got.signals.joints.values, [[np.pi / 2, 0, -np.pi]] * 3)
    np.testing.assert_array_equal(got.signals.truth.values, got.signals.joints.values)


def test_read_unwraps_joints(tmp_path):
    angle = np.linspace(2.0, 9.0, 60)
    turned = (angle + np.pi) % (2.0 * np.pi) - np.pi
    times = T0 + 20 * MS * np.arange(60)
    wrapped = [(int(t), joint_state(int(t), NAMES, [0.1, a, -0.2])) for t, a in zip(times, turned, strict=True)]
    found = read_recording(write(tmp_path / "a.mcap", [joints("/joint_states", wrapped)]), settings())
    assert found.signals.joints is not None
    np.testing.assert_allclose(found.signals.joints.values[:, 1], angle, atol=1e-12)
    assert any("wraps around, 1 times" in f.text and NAMES[1] in f.text for f in found.facts.findings)


def test_read_handles_stamps_after_2038(tmp_path):
    begin = 4_102_444_800 * 10**9
    moved = [begin + k * 20 * MS for k in range(9)]
    rows = [(ns, joint_state(ns - 2**32 * 10**9, NAMES, [0.1, 0.2, 0.3])) for ns in moved]  # sec is int32
    found = read_recording(write(tmp_path / "a.mcap", [joints("/joint_states", rows)]), settings())
    assert found.start_ns == begin and found.signals.joints is not None
    np.testing.assert_allclose(found.signals.joints.t, np.arange(9) * 0.02)


def test_read_rejects_impossible_readings(tmp_path):
    rows = []
    for k in range(40):
        wanted = [0.1, 1e300 if k == 5 else -1e18 if k == 9 else 0.01 * k, 0.2]
        rows.append((T0 + k * 20 * MS, joint_state(T0 + k * 20 * MS, NAMES, wanted)))
    found = read_recording(write(tmp_path / "a.mcap", [joints("/joint_states", rows)]), settings())
    assert found.signals.joints is not None
    assert np.flatnonzero(np.isnan(found.signals.joints.values[:, 1])).tolist() == [5, 9]
    assert any("2 readings beyond 1e+09" in f.text for f in found.facts.findings)


def test_read_drops_a_joint_named_twice(tmp_path):
    rows = [(T0 + MS * i, joint_state(T0 + MS * i, ("a", "b", "a"), (0.1 * i, 0.2 * i, 0.3 * i))) for i in range(9)]
    got = read_recording(write(tmp_path / "a.mcap", [joints("/j", rows)]), PLAIN)
    assert got.signals.joints is not None and got.signals.joints.names == ("b",)
    np.testing.assert_allclose(got.signals.joints.values[:, 0], 0.2 * np.arange(9))
    rows = [(T0 + MS * i, joint_state(T0 + MS * i, ("a", "a"), (0.1, 0.2))) for i in range(9)]
    got = read_recording(write(tmp_path / "b.mcap", [joints("/j", rows)]), PLAIN)
    assert got.signals.joints is None and any("9 (every joint is named more than once)" in f.text for f in got.facts.findings)


def test_read_orders_truth_like_the_joints(tmp_path):
    log = write(tmp_path / "a.mcap", [joints("/j", moves(5)), joints("/truth", moves(5, ("wrist", "elbow")))])
    got = read_recording(log, settings(body=BodySettings(joints=("elbow", "shoulder"))))
    assert got.signals.joints is not None and got.signals.truth is not None
    assert (got.signals.joints.names, got.signals.truth.names) == (("elbow", "shoulder"), ("elbow",))


def test_read_accounts_for_every_message(tmp_path):
    good = moves(40)
    rows = [
        *good,
        (T0 + 30 * MS, good[0][1][:60]),
        (T0 + 31 * MS, joint_state(T0 + 31 * MS, NAMES, ())),
        (T0 + 32 * MS, joint_state(0, NAMES, (1.0, 2.0, 3.0))),
        (T0 + 33 * MS, good[7][1]),
    ]
    got = read_recording(write(tmp_path / "a.mcap", [joints("/j", rows)]), PLAIN)
    reasons = {"malformed": 1, "no positions": 1, "time years away": 1, "same stamp again": 1}
    health = got.facts.health["/j"]
    assert (health.seen, health.used, dict(health.rejected)) == (44, 40, reasons)
    assert health.largest_gap_s == pytest.approx(0.02)
    assert got.signals.joints is not None and len(got.signals.joints.t) == 40
    assert any("rejected" in finding.text and finding.severity == "warning" for finding in got.facts.findings)


def test_read_refuses_missing_cells(tmp_path):
    log = write(tmp_path / "a.mcap", [arrays("/skin", np.full((10, 2), 0.1)), joints("/j", moves(5))])
    assert read_recording(log, settings(topics=TopicSettings(skin="/skin.data[1]"))).signals.skin is not None
    with pytest.raises(LogError, match=r"no usable message on /skin: 10 \(no number in it\)"):
        read_recording(log, settings(topics=TopicSettings(skin="/skin.data[9]")))


def test_frames_are_in_time_order(tmp_path):
    rng = np.random.default_rng(0)
    pictures = [np.full((8, 10, 3), shade, np.uint8) for shade in range(0, 250, 5)]
    rows = [(T0 + 40 * MS * i + MS, compressed(T0 + 40 * MS * i, p)) for i, p in enumerate(pictures)]
    near = np.argsort(np.arange(len(rows)) + rng.uniform(0, 6, len(rows)))
    streams = [camera("/cam", [rows[i] for i in near]), joints("/j", moves(5))]
    log = write(tmp_path / "a.mcap", streams, in_order=False, chunk=700)
    got = read_recording(log, PLAIN)
    assert got.cameras.frames is not None
    for _ in range(2):
        frames = list(got.cameras.frames())
        np.testing.assert_array_equal([f.t for f in frames], np.arange(50) * 40 * MS / 1e9)
        assert [f.source_ns for f in frames] == [t for t, _ in rows]
        assert [int(f.image[0, 0, 0]) for f in frames] == list(range(0, 250, 5))
    assert got.facts.health["/cam"].used == 50
    assert any("out of order" in finding.text for finding in got.facts.findings)


def test_frames_are_streamed(tmp_path):
    noise = np.random.default_rng(1).integers(0, 256, (80, 80, 3), np.uint8)
    peaks = []
    for count in (100, 100, 500):
        rows = [(T0 + 40 * MS * i, compressed(T0 + 40 * MS * i, noise)) for i in range(count)]
        frames = read_recording(write(tmp_path / "a.mcap", [camera("/cam", rows)], chunk=1 << 16), PLAIN).cameras.frames
        assert frames is not None
        tracemalloc.start()
        assert sum(1 for _ in frames()) == count
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[2] < 1.1 * peaks[1], peaks


class _Consumer:
    """Records the images it gets, and how it ended."""

    def __init__(self) -> None:
        self.shades: list[int] = []
        self.ended: list[object] = []

    def __call__(self, frame: LazyImage) -> None:
        self.shades.append(int(frame.image[0, 0, 0]))

    def __enter__(self) -> "_Consumer":
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self.ended.append(kind)


def _consumed_and_read_again(log: Path, wanted: Settings = PLAIN) -> _Consumer:
    """Assert that the consumer gets the same frames that are read afterwards."""
    consumer = _Consumer()
    got, plain = read_recording(log, wanted, consumer=lambda: consumer), read_recording(log, wanted)
    assert got.cameras.consumed is not None and got.cameras.consumed.by is consumer
    assert plain.cameras.consumed is None and consumer.ended == [None]
    frames = list(plain.cameras.frames() if plain.cameras.frames else ())
    assert [consumer.shades[n] for n in got.cameras.consumed.number] == [int(f.image[0, 0, 0]) for f in frames]
    assert got.cameras.consumed.t.tolist() == [f.t for f in frames]
    assert got.cameras.consumed.source_ns.tolist() == [f.source_ns for f in frames]
    assert got.signals.joints is not None and plain.signals.joints is not None
    assert got.signals.joints.values.tobytes() == plain.signals.joints.values.tobytes()
    assert got.facts.health == plain.facts.health
    return consumer


@pytest.mark.parametrize("seed", range(3))
def test_frame_tap_passes_images_in_file_order(tmp_path, seed):
    rng = np.random.default_rng(seed)
    stamps = [T0 + 40 * MS * i for i in range(50)]
    stamps[7], stamps[20] = stamps[6], 0  # one duplicated, one without a time
    rows = [(t + MS, compressed(t, np.full((8, 10, 3), 5 * i, np.uint8))) for i, t in enumerate(stamps)]
    near = np.argsort(np.arange(len(rows)) + rng.uniform(0, 6, len(rows)))
    streams = [camera("/cam", [rows[i] for i in near]), joints("/j", moves(5))]
    consumer = _consumed_and_read_again(write(tmp_path / "a.mcap", streams, in_order=False, chunk=700))
    assert consumer.shades == [5 * i for i in near]


def test_frame_tap_merges_two_types_of_one_camera(tmp_path):
    shades = [(T0 + 20 * MS * i, np.full((4, 4, 3), 10 * i, np.uint8)) for i in range(10)]
    first = camera("/cam", [(t, compressed(t, shade)) for t, shade in shades[5:]])
    kind = "sensor_msgs/msg/CompressedImage"
    other = Stream("/cam", kind, define(kind) + b"\n# a later version", [(t, compressed(t, s)) for t, s in shades[:5]])
    log = write(tmp_path / "a.mcap", [first, other, joints("/j", moves(10))], chunk=700)
    assert len([topic for topic in read_recording(log, PLAIN).facts.topics if topic.name == "/cam"]) == 2
    assert sorted(_consumed_and_read_again(log).shades) == list(range(0, 100, 10))


def test_read_uses_no_consumer_without_a_camera(tmp_path):
    never = write(tmp_path / "a.mcap", [joints("/j", moves(3))])
    image = camera("/cam", [(T0, compressed(T0, np.zeros((8, 8, 3), np.uint8)))])
    ours = write(tmp_path / "b.mcap", [joints("/j", moves(3)), arrays("/bodylog/x", np.ones((3, 2))), image])
    for log in (never, ours):
        assert read_recording(log, PLAIN, consumer=lambda: pytest.fail("got an image")).cameras.consumed is None


def test_read_decompresses_each_chunk_once(tmp_path, monkeypatch):
    noise = np.random.default_rng(1).integers(0, 256, (80, 80, 3), np.uint8)
    unpacked = []
    whole = reader.unpack_chunk
    monkeypatch.setattr(
        reader, "unpack_chunk", lambda data, chunk, to: unpacked.append(chunk.start) or whole(data, chunk, to)
    )
    peaks = []
    for count in (100, 100, 500):
        rows = [(T0 + 40 * MS * i, compressed(T0 + 40 * MS * i, noise)) for i in range(count)]
        log = write(tmp_path / "a.mcap", [camera("/cam", rows), joints("/j", moves(20))], chunk=1 << 16)
        consumer = _Consumer()
        unpacked.clear()
        tracemalloc.start()
        assert read_recording(log, PLAIN, consumer=lambda consumer=consumer: consumer).cameras.consumed is not None
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert len(consumer.shades) == count and len(unpacked) == len(set(unpacked)) > count / 20
    assert peaks[2] < 1.3 * peaks[1], peaks


def test_read_passes_errors_to_the_consumer(tmp_path):
    image, kind = np.zeros((8, 8, 3), np.uint8), "std_msgs/msg/Float32MultiArray"
    pictures = camera("/cam", [(T0 + i, compressed(T0 + i, image)) for i in range(3)])
    log = write(tmp_path / "a.mcap", [pictures, Stream("/skin", kind, define(kind), [(T0, b"\0\1\0\0")])])
    consumer = _Consumer()
    with pytest.raises(LogError, match="no usable message on /skin"):
        read_recording(log, settings(topics=TopicSettings(skin="/skin")), consumer=lambda: consumer)
    assert consumer.ended == [LogError] and len(consumer.shades) == 3


def test_read_rejects_unreadable_images(tmp_path):
    image = np.zeros((8, 8, 3), np.uint8)
    depth = [(T0 + i * MS, compressed(T0 + i * MS, image, form="16UC1; compressedDepth png")) for i in range(3)]
    good = [(T0 + i * MS, compressed(T0 + i * MS, image)) for i in range(3, 8)]
    got = read_recording(write(tmp_path / "a.mcap", [camera("/cam", [*depth, *good])]), PLAIN)
    assert dict(got.facts.health["/cam"].rejected) == {"compressedDepth holds depth, not an image": 3}
    assert got.cameras.frames is not None and len(list(got.cameras.frames())) == 5
    only = write(tmp_path / "b.mcap", [camera("/cam", depth)])
    assert read_recording(only, PLAIN).cameras.frames is None
    with pytest.raises(LogError, match=r"no usable message on /cam: 3 \(compressedDepth"):
        read_recording(only, settings(topics=TopicSettings(camera="/cam")))


def test_read_refuses_a_camera_topic_without_images(tmp_path):
    log = write(tmp_path / "a.mcap", [joints("/j", moves(3))])
    with pytest.raises(LogError, match="but /j is sensor_msgs/msg/JointState; possible: none, the log has no other"):
        read_recording(log, settings(topics=TopicSettings(camera="/j")))


def test_read_ignores_one_message_at_time_zero(tmp_path):
    rows = [(0, joint_state(0, NAMES, (0.0, 0.0, 0.0))), *moves(50)]
    got = read_recording(write(tmp_path / "a.mcap", [joints("/j", rows)]), PLAIN)
    assert (got.start_ns, got.duration_s) == (T0, pytest.approx(0.98))


def test_read_aligns_simulated_stamps(tmp_path):
    wall = 1_600_000_000 * 10**9
    rows = [(wall + t, joint_state(t, NAMES, (1.0, 2.0, 3.0))) for t in range(5 * 10**9, 6 * 10**9, 20 * MS)]
    skin = arrays("/skin", np.ones((10, 3)), start=wall + 5 * 10**9 + 100 * MS)
    got = read_recording(write(tmp_path / "a.mcap", [joints("/j", rows), skin]), PLAIN)
    assert got.start_ns == 5 * 10**9
    assert got.signals.skin is not None
    np.testing.assert_allclose(got.signals.skin.t, 0.1 + 0.01 * np.arange(10))
    assert got.signals.skin.source_ns[0] == wall + 5 * 10**9 + 100 * MS


def test_read_aligns_a_boot_time_camera(tmp_path):
    boot = 300 * 10**9
    image = np.zeros((8, 8, 3), np.uint8)
    pictures = [(T0 + 40 * MS * i + 4 * MS, compressed(boot + 40 * MS * i, image)) for i in range(20)]
    got = read_recording(write(tmp_path / "a.mcap", [camera("/cam", pictures), joints("/j", moves(40))]), PLAIN)
    assert got.cameras.frames is not None
    np.testing.assert_allclose([frame.t for frame in got.cameras.frames()], 0.04 * np.arange(20), atol=1e-12)
    assert got.start_ns == T0 and got.duration_s == pytest.approx(0.78)
    assert any("its clock is not the others'" in finding.text for finding in got.facts.findings)


def test_read_merges_two_publishers(tmp_path):
    every, halves = moves(10), [joints("/j", moves(10)[0::2]), joints("/j", moves(10)[1::2])]
    shades = [(t, compressed(t, np.full((4, 4, 3), 10 * i, np.uint8))) for i, (t, _) in enumerate(every)]
    cameras = [camera("/cam", shades[0::2]), camera("/cam", shades[1::2])]
    got = read_recording(write(tmp_path / "a.mcap", [*halves, *cameras]), PLAIN)
    assert got.signals.joints is not None and got.cameras.frames is not None
    np.testing.assert_array_equal(got.signals.joints.values[:, 0], np.arange(10))
    assert [int(frame.image[0, 0, 0]) for frame in got.cameras.frames()] == [10 * i for i in range(10)]
    assert (got.facts.health["/j"].used, got.facts.health["/cam"].used) == (10, 10)


def test_read_follows_the_clock_setting(tmp_path):
    log = write(tmp_path / "a.mcap", [joints("/j", moves(5)), arrays("/skin", np.ones((10, 3)))])
    got = read_recording(log, settings(time=TimeSettings(joints="log")))
    assert got.start_ns == T0 + 4 * MS
    with pytest.raises(LogError, match=r'skin = "header", but /skin has no header; use "log" or "auto"'):
        read_recording(log, settings(time=TimeSettings(skin="header")))


def test_read_takes_message_paths(tmp_path):
    register("crab_msgs/msg/Servo", "std_msgs/Header header\nfloat32[3] angle\nint32 id\n")
    rows = [
        (T0 + i * MS, cdr("crab_msgs/msg/Servo", header=header(T0 + i * MS), angle=np.float32([i, 1, 2]), id=3))
        for i in range(4)
    ]
    text = b"std_msgs/Header header\nfloat32[3] angle\nint32 id\n"
    log = write(tmp_path / "a.mcap", [Stream("/servo", "crab_msgs/msg/Servo", text, rows)])
    got = read_recording(log, settings(topics=TopicSettings(joints="/servo.angle[0:1]"), body=BodySettings(joints=("a", "b"))))
    assert got.signals.joints is not None
    assert got.signals.joints.values.tolist() == [[i, 1] for i in range(4)]
    assert read_recording(log, settings(topics=TopicSettings(skin="/servo.angle"))).signals.skin is not None
    for wanted, why in (("angles", ".*has no field 'angles'; it has header, angle, id"), ("angle[0", ".*cannot read")):
        with pytest.raises(ConfigError, match=rf"a\.mcap: \[topics\] joints.*{why}"):
            read_recording(log, settings(topics=TopicSettings(joints=f"/servo.{wanted}"), body=BodySettings(joints=("a",))))


def test_read_rejects_arrays_of_another_length(tmp_path):
    odd = arrays("/skin", np.ones((1, 5)), start=T0 + 500 * MS)
    stream = arrays("/skin", np.ones((10, 3)))
    log = write(tmp_path / "a.mcap", [replace(stream, messages=[*stream.messages, *odd.messages])])
    got = read_recording(log, PLAIN)
    assert dict(got.facts.health["/skin"].rejected) == {"5 values, not 3": 1}


def test_read_guesses_skin_by_its_values(tmp_path):
    near = write(tmp_path / "a.mcap", [arrays("/values", np.linspace(0, 1, 30).reshape(10, 3))])
    assert read_recording(near, PLAIN).facts.roles == {"skin": "/values.data"}
    far = write(tmp_path / "b.mcap", [arrays("/values", np.linspace(0, 2, 30).reshape(10, 3))])
    got = read_recording(far, PLAIN)
    assert got.signals.skin is None and got.facts.roles == {}
    assert any("/values was considered, but has no usable message: 10 (values beyond" in f.text for f in got.facts.findings)
    named = read_recording(far, settings(topics=TopicSettings(skin="/values"))).signals.skin
    assert named is not None and named.values.max() == 2
    touching = write(tmp_path / "c.mcap", [arrays("/tactile", np.linspace(0, 2, 30).reshape(10, 3))])
    assert read_recording(touching, PLAIN).facts.roles == {"skin": "/tactile.data"}


def test_read_refuses_a_missing_configured_role(tmp_path):
    log = write(tmp_path / "a.mcap", [joints("/j", moves(3))])
    got = read_recording(log, PLAIN)
    assert (got.signals.skin, got.signals.truth, got.cameras.frames, got.signals.features) == (None, None, None, None)
    with pytest.raises(LogError, match=r'\[topics\] skin = "/skn"'):
        read_recording(log, settings(topics=TopicSettings(skin="/skn")))


def test_read_accepts_an_empty_log(tmp_path):
    got = read_recording(write(tmp_path / "a.mcap", []), PLAIN)
    assert (got.signals.joints, got.duration_s, dict(got.facts.roles)) == (None, 0, {})


def test_read_refuses_a_file_that_is_not_a_log(tmp_path):
    with pytest.raises(LogError, match="there is no such file"):
        read_recording(tmp_path / "a.mcap", PLAIN)


def test_read_takes_a_video_as_camera(tmp_path):
    shades = list(range(20, 220, 20))
    out = cv2.VideoWriter(str(tmp_path / "cam.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (32, 24))
    for shade in shades:
        out.write(np.full((24, 32, 3), shade, np.uint8))
    out.release()
    log = write(tmp_path / "a.mcap", [joints("/j", moves(5))])
    got = read_recording(log, settings(topics=TopicSettings(camera="cam.avi")))
    assert got.cameras.frames is not None and got.facts.roles["camera"] == "cam.avi"
    frames = list(got.cameras.frames())
    assert (got.facts.health["cam.avi"].seen, got.facts.health["cam.avi"].used) == (10, 10)
    np.testing.assert_allclose([f.t for f in frames], np.arange(10) / 10)
    assert np.abs([float(f.image.mean()) for f in frames] - np.array(shades)).max() < 4
    assert frames[0].decode(4).shape == (6, 8, 3)
    later = settings(topics=TopicSettings(camera="cam.avi", start=T0 / 1e9 + 2.5, rate=20.0))
    shifted = read_recording(log, later).cameras.frames
    assert shifted is not None
    np.testing.assert_allclose([f.t for f in shifted()], 2.5 + np.arange(10) / 20)
    times = T0 / 1e9 + 0.5 + np.arange(10) / 10 + 0.03 * (np.arange(10) % 2)
    (tmp_path / "cam_timestamps.csv").write_text("\n".join(["unix_s", *(f"{t:.6f}" for t in times)]))
    dated = read_recording(log, settings(topics=TopicSettings(camera="cam.avi"))).cameras.frames
    assert dated is not None
    np.testing.assert_allclose([f.t for f in dated()], times - T0 / 1e9, atol=1e-6)
    moved = read_recording(log, settings(topics=TopicSettings(camera="cam.avi", start=T0 / 1e9 + 2.5))).cameras.frames
    assert moved is not None
    np.testing.assert_allclose([f.t for f in moved()], 2.5 + times - times[0], atol=1e-6)
    (tmp_path / "cam_timestamps.csv").write_text("unix_s\n1\n2\n")
    with pytest.raises(LogError, match=r"cam_timestamps.csv: 2 rows for the 10 frames of cam.avi"):
        read_recording(log, settings(topics=TopicSettings(camera="cam.avi")))
    with pytest.raises(LogError, match="no such file, here or beside the log"):
        read_recording(log, settings(topics=TopicSettings(camera="gone.mp4")))
    (tmp_path / "no.mp4").write_bytes(b"not a video")
    with pytest.raises(LogError, match="no video: its first bytes"):
        read_recording(log, settings(topics=TopicSettings(camera="no.mp4")))


def test_info_is_plain_and_complete(tmp_path):
    log = write(tmp_path / "a.mcap", [joints("/j", moves(11)), camera("/cam", [])])
    wanted = json.loads(json.dumps(describe_log(log, PLAIN)))
    assert wanted["topics"] == [
        {"topic": "/cam", "type": "sensor_msgs/msg/CompressedImage", "messages": 0, "rate_hz": None},
        {"topic": "/j", "type": "sensor_msgs/msg/JointState", "messages": 11, "rate_hz": pytest.approx(50)},
    ]
    assert (wanted["path"], wanted["format"], wanted["start_ns"]) == (str(log), "mcap", T0 + 4 * MS)
    assert wanted["duration_s"] == pytest.approx(0.2)
    assert (wanted["roles"], wanted["joints"]) == ({"joints": "/j"}, list(NAMES))
    clock = {"clock": "header", "offset_s": pytest.approx(0.004), "spread_s": pytest.approx(0)}
    assert wanted["clock"]["joints"] == clock
    assert any('topics = { joints = "/j" }' in finding["text"] for finding in wanted["findings"])


@pytest.mark.parametrize("folder", [False, True])
def test_info_rates_use_the_topics_duration(tmp_path, folder):
    short, long = arrays("/brief", np.ones((21, 1)), every=50 * MS), arrays("/long", np.ones((401, 1)), every=25 * MS)
    if folder:
        cut = [(long.messages[:200], "a_0.mcap"), (long.messages[200:], "a_1.mcap")]
        for messages, name in cut:
            write(tmp_path / name, [replace(long, messages=messages), *([short] if name == "a_0.mcap" else [])])
    else:
        write(tmp_path / "a.mcap", [short, long], chunk=1000)
    wanted = describe_log(tmp_path if folder else tmp_path / "a.mcap", PLAIN)
    rates = {topic["topic"]: topic["rate_hz"] for topic in wanted["topics"]}
    assert rates == {"/brief": pytest.approx(20), "/long": pytest.approx(40)}


def test_read_is_deterministic(tmp_path):
    log = write(tmp_path / "a.mcap", [joints("/j", moves(9)), arrays("/skin", np.ones((9, 2)))])
    one, two = read_recording(log, PLAIN), read_recording(Path(str(log)), PLAIN)
    assert one.signals.joints is not None and two.signals.joints is not None
    assert one.signals.joints.values.tobytes() == two.signals.joints.values.tobytes()
    assert (one.facts.health, one.facts.findings) == (two.facts.health, two.facts.findings)


@pytest.fixture(scope="module")
def unguarded(tmp_path_factory) -> bytes:
    """A small log of every role, without compression and CRCs, so that damage reaches the decoding."""
    image = np.random.default_rng(5).integers(0, 256, (12, 16, 3), np.uint8)
    pictures = [(T0 + 40 * MS * i, compressed(T0 + 40 * MS * i, image, ".jpg", "jpeg")) for i in range(4)]
    skin = arrays("/skin", np.ones((12, 4)))
    streams = [joints("/j", moves(12)), joints("/truth", moves(12)), skin, camera("/cam", pictures)]
    path = tmp_path_factory.mktemp("fuzz") / "a.mcap"
    return write(path, streams, chunk=1 << 11, checked=False).read_bytes()


@pytest.mark.parametrize("seed", range(6))
def test_read_survives_damage_anywhere(unguarded, tmp_path, seed):
    rng = np.random.default_rng(seed)
    log = tmp_path / "a.mcap"
    for _ in range(25):
        broken = np.frombuffer(unguarded, np.uint8).copy()
        broken[rng.integers(8, len(broken), rng.integers(1, 6))] ^= rng.integers(1, 256, dtype=np.uint8)
        log.write_bytes(broken[: len(broken) if rng.random() < 0.7 else rng.integers(0, len(broken))].tobytes())
        try:
            got = read_recording(log, PLAIN)
            for frame in got.cameras.frames() if got.cameras.frames else ():
                with contextlib.suppress(FormatError):
                    frame.decode(2)
        except BodylogError as error:
            assert "\n" not in str(error)
        else:
            assert all(h.used + sum(h.rejected.values()) == h.seen for h in got.facts.health.values())
            assert got.signals.joints is None or np.all(np.diff(got.signals.joints.t) > 0)
        assert isinstance(info_or_error(log), str)


def info_or_error(log: Path) -> str:
    try:
        return json.dumps(describe_log(log, PLAIN))
    except BodylogError as error:
        return str(error)


def test_read_uses_each_cameras_stamps(tmp_path):
    every, late = 40 * MS, 13 * MS
    shots = {"/head/image": (0, range(10, 60, 10)), "/side/image": (late, range(100, 180, 10))}
    films = []
    for topic, (first, shades) in shots.items():
        stamps = [(T0 + first + i * every, np.full((8, 8, 3), shade, np.uint8)) for i, shade in enumerate(shades)]
        films.append(camera(topic, [(t + 20 * MS, compressed(t, image)) for t, image in stamps]))
    log = write(tmp_path / "a.mcap", [joints("/j", moves(20)), *films])
    got = read_recording(log, settings(topics=TopicSettings(camera=tuple(shots))))
    assert got.cameras.frames is not None and list(got.cameras.views) == ["side"]
    assert (got.facts.roles["camera"], got.facts.roles["camera/side"]) == tuple(shots)
    for film, (first, shades) in zip((got.cameras.frames, got.cameras.views["side"]), shots.values(), strict=True):
        frames = list(film())
        np.testing.assert_allclose([f.t for f in frames], (first + every * np.arange(len(shades))) / 1e9)
        assert [int(f.image[0, 0, 0]) for f in frames] == list(shades)
    assert got.facts.health["/side/image"].used == 8
    assert not read_recording(log, PLAIN).cameras.views
    silent = write(tmp_path / "b.mcap", [joints("/j", moves(20)), films[0], camera("/side/image", [])])
    with pytest.raises(LogError, match="no usable message on /side/image: it is empty"):
        read_recording(silent, settings(topics=TopicSettings(camera=tuple(shots))))


def test_read_rejects_joints_with_falling_times(tmp_path):
    skin = arrays("/skin", np.linspace(0, 1, 60).reshape(20, 3))
    log = write(tmp_path / "a.mcap", [joints("/joint_states", moves(10)[::-1]), skin], in_order=False)
    got = read_recording(log, PLAIN)
    assert got.signals.joints is None
    assert any("/joint_states" in f.text and "10 (time runs backwards)" in f.text for f in got.facts.findings)
    with pytest.raises(LogError, match=r"/joint_states: 10 \(time runs backwards\)"):
        read_recording(log, settings(topics=TopicSettings(joints="/joint_states")))


def test_read_sorts_a_reversed_file(tmp_path):
    log = write(tmp_path / "a.mcap", [joints("/joint_states", moves(10)[::-1])], in_order=False)
    got = read_recording(log, PLAIN)
    assert got.signals.joints is not None and len(got.signals.joints.t) == 10

"""Joints of several topics become one signal; changes, gaps and invalid values are reported."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bodylog.errors import ConfigError, LogError
from bodylog.recording.facts import describe_log
from bodylog.recording.recording import read_recording
from bodylog.recording.roles import topic_name
from bodylog.settings import BodySettings, Settings, TimeSettings, TopicSettings
from tests.logs.writing import T0, Stream, joint_state, joints, write

MS = 10**6


def _topic(name: str, names: tuple[str, ...], step_ms: int, count: int, late_ms: float = 0.0):
    """A topic of joints that all read the time in s, plus ten times the joint's number."""
    messages = []
    for k in range(count):
        ns = T0 + k * step_ms * MS
        stamp = ns + round(late_ms * MS)
        messages.append((ns + MS, joint_state(stamp, names, [10.0 * j + (ns - T0) / 1e9 for j in range(len(names))])))
    return joints(name, messages)


@pytest.fixture
def two(tmp_path) -> Path:
    """An arm at 100 Hz and a head at 50 Hz, 3 ms beside it."""
    arm, head = _topic("/arm/joint_states", ("pan", "lift"), 10, 300), ("/head/joint_states", ("neck",), 20, 150, 3.0)
    return write(tmp_path / "two.mcap", [arm, _topic(*head)])


def test_series_merges_topics_without_shared_names(two):
    found = read_recording(two, Settings())
    assert found.facts.roles["joints"] == "/arm/joint_states" and found.facts.roles["joints/head"] == "/head/joint_states"
    assert found.signals.joints.names == ("pan", "lift", "neck") and found.facts.beside == ("neck",)
    assert len(found.signals.joints.t) == 450 and np.all(np.diff(found.signals.joints.t) > 0)
    arm = np.isfinite(found.signals.joints.values[:, 0])
    assert arm.sum() == 300 and np.isnan(found.signals.joints.values[arm, 2]).all()
    np.testing.assert_allclose(found.signals.joints.values[~arm, 2], found.signals.joints.t[~arm] - 0.003, atol=1e-9)
    alone = read_recording(two, Settings(topics=TopicSettings(joints="/arm/joint_states")))
    np.testing.assert_array_equal(alone.signals.joints.values, found.signals.joints.values[arm, :2])
    np.testing.assert_array_equal(alone.signals.joints.t, found.signals.joints.t[arm])
    assert describe_log(two, Settings())["joints"] == ["pan", "lift", "neck"]


def test_series_applies_each_topics_delay(two):
    settings = Settings(time=TimeSettings(delay={"joints/head": 0.003}))
    found = read_recording(two, settings)
    assert len(found.signals.joints.t) == 300  # the head's readings are now at every second one of the arm
    whole = np.isfinite(found.signals.joints.values).all(axis=1)
    np.testing.assert_allclose(found.signals.joints.values[whole, 2], found.signals.joints.t[whole], atol=1e-9)
    with pytest.raises(ConfigError, match=r"'joints/neck'; possible: joints/arm, joints/head"):
        read_recording(two, Settings(time=TimeSettings(delay={"joints/neck": 0.003})))


def test_names_add_the_topic_to_shared_names(tmp_path):
    left, right = (_topic(f"/{side}/joint_states", ("elbow", side), 10, 50) for side in ("left", "right"))
    path = write(tmp_path / "sides.mcap", [left, right])
    guessed = read_recording(path, Settings())
    assert guessed.signals.joints.names == ("elbow", "left") and "joints/right" not in guessed.facts.roles
    assert any('joints = ["/left/joint_states", "/right/joint_states"]' in f.text for f in guessed.facts.findings)
    both = Settings(topics=TopicSettings(joints=("/left/joint_states", "/right/joint_states")))
    found = read_recording(path, both)
    assert found.signals.joints.names == ("left/elbow", "left", "right/elbow", "right") and found.facts.beside == ()
    chosen = read_recording(path, replace(both, body=BodySettings(joints=("right/elbow", "left"))))
    assert chosen.signals.joints.names == ("right/elbow", "left")
    with pytest.raises(LogError, match="names 'elbow'; the log has left, left/elbow, right, right/elbow"):
        read_recording(path, replace(both, body=BodySettings(joints=("elbow",))))
    with pytest.raises(LogError, match="there is no topic '/up/joint_states'"):
        read_recording(path, Settings(topics=TopicSettings(joints=("/left/joint_states", "/up/joint_states"))))
    with pytest.raises(ConfigError, match="both get the name 'left'"):
        read_recording(path, Settings(topics=TopicSettings(joints=("/left/joint_states", "/left"))))


@pytest.mark.parametrize(
    ("topic", "name"),
    [("/head/joint_states", "head"), ("/joint_states", "joint_states"), ("/a/b/joint_state", "a/b"), ("/arm", "arm")],
)
def test_topic_name_drops_generic_words(topic, name):
    assert topic_name(topic) == name


def test_roles_ignore_commands_and_copies(tmp_path):
    parts = [
        _topic("/joint_states", ("pan", "lift"), 10, 50),
        _topic("/pan_command", ("other",), 10, 50),
        _topic("/arm/joint_states", ("pan",), 10, 50),
    ]
    found = read_recording(write(tmp_path / "x.mcap", parts), Settings())
    assert found.signals.joints.names == ("pan", "lift") and found.facts.beside == ()


def _texts(path: Path) -> str:
    return " | ".join(f"{f.severity}: {f.text}" for f in read_recording(path, Settings()).facts.findings)


def test_read_reports_two_publishers_on_one_topic(tmp_path):
    one, two = _topic("/joint_states", ("pan", "lift"), 10, 100), _topic("/joint_states", ("neck",), 10, 100, 4.0)
    messages = [m for pair in zip(one.messages, two.messages, strict=True) for m in pair]
    path = write(tmp_path / "x.mcap", [replace(one, messages=messages)])
    texts = (
        "2 lists of joints on one topic, in turn, 199 times: several publishers: pan, lift (100 messages); neck (100"
    )
    assert texts in _texts(path)


def test_joints_in_varying_order_are_one_list(tmp_path):
    one, two = _topic("/joint_states", ("pan", "lift"), 10, 100), _topic("/joint_states", ("lift", "pan"), 10, 100, 4.0)
    messages = [m for pair in zip(one.messages, two.messages, strict=True) for m in pair]
    path = write(tmp_path / "x.mcap", [replace(one, messages=messages)])
    assert "lists of joints" not in _texts(path)
    assert set(read_recording(path, Settings()).signals.joints.names) == {"pan", "lift"}


def test_read_reports_changing_and_vanishing_joints(tmp_path):
    whole, less = _topic("/joint_states", ("pan", "lift"), 10, 600), _topic("/joint_states", ("pan",), 10, 600)
    messages = [*whole.messages[:300], *less.messages[300:]]
    texts = _texts(write(tmp_path / "x.mcap", [replace(whole, messages=messages)]))
    assert "2 lists of joints on one topic, the list changes: pan, lift (300 messages); pan (300 messages)" in texts
    vanishes = "lift vanishes: no reading after 2.990 s, while others go on until 5.990 s"
    assert f"warning: joints /joint_states: {vanishes}" in texts
    messages = [*less.messages[:300], *whole.messages[300:]]
    texts = _texts(write(tmp_path / "y.mcap", [replace(whole, messages=messages)]))
    assert "lift has no reading before 3.000 s" in texts


def test_read_counts_positions_that_are_texts(tmp_path):
    def message(k: int) -> bytes:
        ns = T0 + k * 10 * MS
        position = ["0.1", "x"] if k % 4 == 3 else [0.1 * k, 0.2]
        stamp = {"sec": ns // 10**9, "nsec": ns % 10**9}
        return json.dumps({"header": {"stamp": stamp}, "name": ["pan", "lift"], "position": position}).encode()

    rows = [(T0 + k * 10 * MS, message(k)) for k in range(40)]
    stream = Stream("/joint_states", "sensor_msgs/msg/JointState", b"{}", rows, "json", "jsonschema")
    path = write(tmp_path / "x.mcap", [stream])
    found = read_recording(path, Settings())
    health = found.facts.health["/joint_states"]
    assert (health.seen, health.used) == (40, 30) and health.rejected == {"positions that are not numbers": 10}
    assert "rejected 10 (positions that are not numbers) of 40 messages" in _texts(path)

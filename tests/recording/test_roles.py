"""Guesses from types, names and counts; robot.toml takes precedence; errors for missing topics list existing ones."""

import tomllib

import pytest

from bodylog.errors import ConfigError, LogError
from bodylog.recording.cameras import camera_name_of_source
from bodylog.recording.role_hints import (
    advice_on_roles,
    find_unreadable_topics,
    unused_cameras,
    unused_joints,
)
from bodylog.recording.roles import assign_roles
from bodylog.settings import TopicSettings
from bodylog.types import Topic

JOINTS, IMAGE, COMPRESSED = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
FLOATS = "std_msgs/msg/Float32MultiArray"
SKIN = b"SkinCellData[] data\n===\nMSG: tum_ics_skin_msgs/SkinCellData\nint32 cellId\nint64 ts\nfloat32[] prox\n"


def topics(*described) -> list[Topic]:
    """(name, type, messages, definition) with the last two optional; definitions default to the standard ones."""
    return [_topic(number, *some) for number, some in enumerate(described)]


def _topic(number: int, name: str, kind: str, messages: int = 10, definition: bytes = b"") -> Topic:
    return Topic(number, name, kind, "cdr", definition, "ros2msg", messages)


def guessed(*described) -> dict[str, str]:
    return {role: found.path for role, found in assign_roles(topics(*described), TopicSettings(), "x.mcap").items()}


def test_roles_assigns_every_role():
    found = guessed(
        ("/joint_states", JOINTS, 500),
        ("/joint_commands", JOINTS, 900),
        ("/truth/joint_states", JOINTS, 500),
        ("/cam/depth/image", IMAGE, 60),
        ("/cam/color/image", COMPRESSED, 30),
        ("/skin/proximity", FLOATS, 100),
        ("/weights", FLOATS, 100),
        ("/bodylog/joint_states", JOINTS, 9000),
    )
    assert found == {
        "joints": "/joint_states",
        "truth": "/truth/joint_states",
        "camera": "/cam/color/image",
        "skin": "/skin/proximity.data",
    }


@pytest.mark.parametrize("word", ["command", "cmd", "desired", "target", "goal"])
def test_roles_prefer_measured_joints_to_commands(word):
    assert guessed((f"/joint_{word}", JOINTS, 99), ("/joint_states", JOINTS, 1))["joints"] == "/joint_states"
    assert guessed((f"/joint_{word}", JOINTS, 99))["joints"] == f"/joint_{word}"


@pytest.mark.parametrize(("name", "is_truth"), [
    ("/truth/joint_states", True), ("/ground_truth", True), ("/gt/joints", True), ("/arm_gt", True),
    ("/gt200/joint_states", False), ("/length", False), ("/joint_states", False),
])  # fmt: skip
def test_roles_guess_truth_by_name(name, is_truth):
    assert guessed((name, JOINTS)) == ({"truth": name} if is_truth else {"joints": name})


def test_roles_prefer_more_messages_then_the_alphabet():
    assert guessed(("/b", JOINTS, 5), ("/a", JOINTS, 9))["joints"] == "/a"
    assert guessed(("/b", JOINTS, 5), ("/a", JOINTS, 5))["joints"] == "/a"


def test_roles_prefer_the_larger_body():
    messages = {"/gripper": 510, "/arm": 500, "/calibration": 2, "/bodylog/j": 900}
    joints = {"/gripper": 1, "/arm": 6, "/calibration": 20, "/bodylog/j": 30}
    described = topics(*((name, JOINTS, count) for name, count in messages.items()))
    names = {topic: tuple(f"{topic}{k}" for k in range(count)) for topic, count in joints.items()}
    found = assign_roles(described, TopicSettings(), "x.mcap", lambda topic: names[topic.name])
    assert found["joints"].topic == "/arm" and found["joints/gripper"].topic == "/gripper" and len(found) == 2


def test_roles_ignore_empty_topics_and_depth():
    assert guessed(("/joint_states", JOINTS, 0), ("/cam/depth/image_raw", IMAGE, 5)) == {}


@pytest.mark.parametrize(
    ("better", "worse"), [("/cam/rgb/image", "/cam/image"), ("/cam/image", "/cam/mono"), ("/cam/color", "/cam/ir_1")]
)
def test_roles_prefer_colour(better, worse):
    assert guessed((worse, IMAGE, 90), (better, IMAGE, 30))["camera"] == better


def test_roles_find_skin_in_structs_and_arrays():
    cells = ("/forearm", "tum_ics_skin_msgs/msg/SkinCellDataArray", 5, SKIN)
    assert guessed(cells)["skin"] == "/forearm.data[:].prox[0]"
    custom = ("/hand/tactile", "x_msgs/msg/Taxels", 5, b"uint8 kind\nuint16[] cells\nfloat32[16] pressure\n")
    assert guessed(custom)["skin"] == "/hand/tactile.pressure"
    counts = ("/hand/tactile", "x_msgs/msg/Taxels", 5, b"uint8 kind\nuint16[] cells\n")
    assert guessed(counts)["skin"] == "/hand/tactile.cells"
    assert guessed(("/touch/events", "std_msgs/msg/String", 5)) == {}


def test_roles_skip_only_a_broken_topic():
    broken = ("/a/joint_states", JOINTS, 500, b"}{")
    assert guessed(broken, ("/joint_states", JOINTS, 5))["joints"] == "/joint_states"
    (problem,) = find_unreadable_topics(topics(broken, ("/joint_states", JOINTS, 5)))
    assert problem.startswith("/a/joint_states: sensor_msgs/msg/JointState: cannot read")


def test_roles_follow_robot_toml():
    declared = TopicSettings(joints="/b", skin="/w.data[0:3]", camera="/depth", truth="/a")
    found = assign_roles(topics(("/a", JOINTS), ("/b", JOINTS), ("/w", FLOATS), ("/depth", IMAGE)), declared, "x.mcap")
    assert {role: (f.topic, f.field) for role, f in found.items()} == {
        "joints": ("/b", ""),
        "skin": ("/w", "data[0:3]"),
        "camera": ("/depth", ""),
        "truth": ("/a", ""),
    }


def test_roles_list_topics_for_a_missing_one():
    with pytest.raises(LogError, match=r'x.mcap: \[topics\] joints = "/q", .* possible: /a, /b$'):
        assign_roles(topics(("/a", JOINTS), ("/b", JOINTS), ("/w", FLOATS)), TopicSettings(joints="/q"), "x.mcap")
    with pytest.raises(LogError, match=r"possible: /w$"):
        assign_roles(topics(("/w", "std_msgs/msg/String")), TopicSettings(joints="/q"), "x.mcap")
    with pytest.raises(LogError, match="no topic of the log can be read"):
        assign_roles([], TopicSettings(joints="/q"), "x.mcap")


def test_roles_refuse_a_topic_without_numbers():
    with pytest.raises(LogError, match="has no array; say which"):
        assign_roles(topics(("/w", "std_msgs/msg/String")), TopicSettings(skin="/w"), "x.mcap")


def test_advice_is_toml_of_the_same_roles():
    described = [("/joint_states", JOINTS), ('/cam "1"', IMAGE), ("/skin", FLOATS)]
    found = assign_roles(topics(*described), TopicSettings(), "x.mcap")
    declared = tomllib.loads(advice_on_roles(found))["topics"]
    assert declared == {"joints": "/joint_states", "camera": '/cam "1"', "skin": "/skin.data"}
    assert {r: f.path for r, f in assign_roles(topics(*described), TopicSettings(**declared), "x.mcap").items()} == declared


def test_roles_merge_schemas_of_one_topic():
    found = assign_roles(topics(("/a", JOINTS, 5), ("/a", JOINTS, 7), ("/a", FLOATS, 7)), TopicSettings(), "x.mcap")
    assert [topic.messages for topic in found["joints"].topics] == [5, 7]


CAMERAS = (("/head/image_raw", IMAGE, 30), ("/side/image_raw", IMAGE, 20), ("/side/image_raw/compressed", COMPRESSED))


def test_roles_name_several_cameras():
    named = TopicSettings(camera=("/side/image_raw", "/head/image_raw"))
    found = assign_roles(topics(*CAMERAS), named, "x.mcap")
    assert {key: role.path for key, role in found.items()} == {
        "camera": "/side/image_raw", "camera/head": "/head/image_raw"
    }  # fmt: skip
    assert tomllib.loads(advice_on_roles(found)) == {"topics": {"camera": ["/side/image_raw", "/head/image_raw"]}}
    with pytest.raises(LogError, match="there is no topic '/top/image'; possible: /head/image_raw, /side/image_raw"):
        assign_roles(topics(*CAMERAS), TopicSettings(camera=("/side/image_raw", "/top/image")), "x.mcap")
    for again in ("/head/image_raw", "/side/image_raw", "/side/image_raw/compressed"), ("/side/image_raw", "/side"):
        with pytest.raises(ConfigError, match="both get the name 'side'"):
            assign_roles(topics(*CAMERAS), TopicSettings(camera=again), "x.mcap")


@pytest.mark.parametrize(("declared", "name"), [
    ("/side/image", "side"), ("/cameras/left/image_rect_color/compressed", "cameras/left"), ("/side", "side"),
    ("/image", "image"), ("films/side.MP4", "side"), ("/imager", "imager"),
])  # fmt: skip
def test_camera_name_drops_generic_words(declared, name):
    assert camera_name_of_source(declared) == name


def test_unused_cameras_are_reported():
    found = assign_roles(topics(*CAMERAS), TopicSettings(), "x.mcap")
    (finding,) = unused_cameras(topics(*CAMERAS), TopicSettings(), found)
    typed = 'type: [topics] camera = ["/head/image_raw", "/side/image_raw"]'
    assert found["camera"].path == "/head/image_raw"
    assert finding.text == f"camera: /head/image_raw is used, /side/image_raw not; for more, {typed}"
    assert not unused_cameras(topics(*CAMERAS), TopicSettings(camera="/head/image_raw"), found)
    assert not unused_cameras(topics(*CAMERAS[1:]), TopicSettings(), assign_roles(topics(*CAMERAS[1:]), TopicSettings(), "x.mcap"))


def test_roles_never_guess_a_reference():
    there = topics(("/joint_states", JOINTS), ("/truth/joint_states", JOINTS))
    named = TopicSettings(reference="/truth/joint_states")
    assert "reference" not in assign_roles(there, TopicSettings(), "x.mcap")
    found = assign_roles(there, named, "x.mcap")
    assert found["reference"].path == found["truth"].path == "/truth/joint_states"
    assert "reference" not in assign_roles(there[:1], named, "x.mcap")


@pytest.mark.parametrize(
    ("declared", "wrong", "possible"),
    [
        ({"camera": "/joint_states"}, JOINTS, "/cam/color"),
        ({"camera": "/weights"}, FLOATS, "/cam/color"),
        ({"skin": "/joint_states"}, JOINTS, "/weights"),
        ({"joints": "/cam/color"}, COMPRESSED, "/joint_states"),
        ({"truth": "/cam/color"}, COMPRESSED, "/joint_states, /weights"),
    ],
)
def test_roles_refuse_a_topic_of_another_roles_type(declared, wrong, possible):
    there = topics(("/joint_states", JOINTS), ("/cam/color", COMPRESSED), ("/weights", FLOATS))
    ((role, name),) = declared.items()
    with pytest.raises(LogError) as refused:
        assign_roles(there, TopicSettings(**declared), "x.mcap")
    assert str(refused.value) == f'x.mcap: [topics] {role} = "{name}", but {name} is {wrong}; possible: {possible}'


@pytest.mark.parametrize("kind", ["foxglove_msgs/msg/CompressedVideo", "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"])
def test_unused_cameras_advise_on_video_packets(kind):
    there = topics(("/joint_states", JOINTS), ("/cam", kind, 10, b"string format\nstring encoding\nuint8[] data\n"))
    (finding,) = unused_cameras(there, TopicSettings(), assign_roles(there, TopicSettings(), "x.mcap"))
    assert finding.severity == "warning"
    assert finding.text.startswith("camera: /cam holds a video's packets, not images")
    with pytest.raises(LogError, match=rf"/cam is {kind} \(a video's packets, .* republish .* possible: none"):
        assign_roles(there, TopicSettings(camera="/cam"), "x.mcap")


def test_roles_accept_a_named_field_of_any_type():
    found = assign_roles(topics(("/joint_states", JOINTS)), TopicSettings(skin="/joint_states.effort"), "x.mcap")
    assert found["skin"].path == "/joint_states.effort"


def test_unused_joints_are_reported():
    two = topics(("/a/joint_states", JOINTS), ("/b/joint_states", JOINTS), ("/truth/joint_states", JOINTS))
    found = assign_roles(two, TopicSettings(), "x.mcap")
    (finding,) = unused_joints(two, TopicSettings(), found)
    both = 'for both, joints = ["/a/joint_states", "/b/joint_states"]'
    typed = f'for another, type: [topics] joints = "/b/joint_states"; {both}'
    assert finding.text == f"joints: /a/joint_states is used, /b/joint_states not; {typed}"
    assert not unused_joints(two, TopicSettings(joints="/a/joint_states"), found)
    assert not unused_joints(two[:1], TopicSettings(), assign_roles(two[:1], TopicSettings(), "x.mcap"))

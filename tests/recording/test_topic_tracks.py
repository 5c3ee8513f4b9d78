"""Positions from other detectors, in topics or tables, become tracks."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bodylog.errors import ConfigError, LogError
from bodylog.pipeline import observe
from bodylog.recording.recording import read_recording
from bodylog.settings import Settings
from bodylog.sources import TableSource, TopicSource
from tests.logs.writing import (
    T0,
    Stream,
    _message,
    cdr,
    define,
    header,
    joint_state,
    joints,
    register,
    write,
)

MS = 10**6
COUNT = 12
APRILTAG = """std_msgs/Header header
apriltag_msgs/AprilTagDetection[] detections
"""
DETECTION = """string family
int32 id
int32 hamming
float32 goodness
float32 decision_margin
apriltag_msgs/Point centre
apriltag_msgs/Point[4] corners
float64[9] homography
"""
BOXES = """std_msgs/Header header
vision_msgs/Detection2D[] detections
"""
BOX = """std_msgs/Header header
string id
vision_msgs/BoundingBox2D bbox
"""
FIDUCIALS = """std_msgs/Header header
int32 image_seq
fiducial_msgs/Fiducial[] fiducials
"""
FIDUCIAL = "int32 fiducial_id\nint32 direction\n" + "".join(f"float64 {a}{k}\n" for k in range(4) for a in "xy")
PARTS: Mapping[str, Mapping[str, str]] = {
    "apriltag_msgs/msg/AprilTagDetectionArray": {
        "apriltag_msgs/msg/Point": "float64 x\nfloat64 y\n",
        "apriltag_msgs/msg/AprilTagDetection": DETECTION,
        "apriltag_msgs/msg/AprilTagDetectionArray": APRILTAG,
    },
    "vision_msgs/msg/Detection2DArray": {
        "vision_msgs/msg/Point2D": "float64 x\nfloat64 y\n",
        "vision_msgs/msg/Pose2D": "vision_msgs/Point2D position\nfloat64 theta\n",
        "vision_msgs/msg/BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
        "vision_msgs/msg/Detection2D": BOX,
        "vision_msgs/msg/Detection2DArray": BOXES,
    },
    "fiducial_msgs/msg/FiducialArray": {
        "fiducial_msgs/msg/Fiducial": FIDUCIAL,
        "fiducial_msgs/msg/FiducialArray": FIDUCIALS,
    },
}
PLACES = np.column_stack([100.0 + np.arange(COUNT), 50.0 - 2.0 * np.arange(COUNT)])


for _parts in PARTS.values():
    for _type, _text in _parts.items():
        register(_type, _text)


def _stamps() -> list[int]:
    return [T0 + k * 100 * MS for k in range(COUNT)]


def _log(folder: Path, *streams: Stream) -> Path:
    rows = [(T0 + k * 10 * MS + MS, joint_state(T0 + k * 10 * MS, ["pan"], [0.01 * k])) for k in range(10 * COUNT)]
    return write(folder / "x.mcap", [joints("/joint_states", rows), *streams])


def _stream(type_: str, messages: list[dict[str, Any]], topic: str = "/seen") -> Stream:
    rows = [(ns + 7 * MS, cdr(type_, header=header(ns), **m)) for ns, m in zip(_stamps(), messages, strict=True)]
    return Stream(topic, type_, define(type_), rows)


def _tag(number: int, x: float, y: float) -> Any:
    point = ("apriltag_msgs/msg/Point", {"x": x, "y": y})
    rest = {"family": "36h11", "hamming": 0, "goodness": 1.0, "decision_margin": 9.0, "corners": [point] * 4}
    fields = {"id": number, "centre": point, "homography": np.zeros(9), **rest}
    return _nested("apriltag_msgs/msg/AprilTagDetection", fields)


def _nested(type_: str, fields: dict[str, Any]) -> Any:
    nested = {key for key, value in fields.items() if isinstance(value, list) and isinstance(value[0], tuple)}
    return (type_, {key: [_message(*i) for i in v] if key in nested else v for key, v in fields.items()})


def _list(*items: Any) -> list[Any]:
    return [_message(*item) for item in items]


def _seen(path: Path, source: TopicSource, name: str = "tip"):
    settings = Settings(features={name: source})
    found = observe(path, settings)[1]
    return found.tracks[name], found.health[name]


def _is_there(track, health, hidden=()) -> None:
    expected = PLACES.copy()
    expected[list(hidden)] = np.nan
    np.testing.assert_allclose(track.values, expected)
    np.testing.assert_allclose(track.t, np.arange(COUNT) / 10, atol=1e-9)
    assert (health.seen, health.used) == (COUNT, COUNT - len(hidden))


def test_track_reads_points_by_type(tmp_path):
    points = [{"point": ("geometry_msgs/msg/Point", {"x": x, "y": y, "z": 0.0})} for x, y in PLACES.tolist()]
    path = _log(tmp_path, _stream("geometry_msgs/msg/PointStamped", points))
    track, health = _seen(path, TopicSource("/seen"))
    _is_there(track, health)
    assert track.std is None  # none is given: the model's noise applies


def test_track_selects_a_tag_by_number(tmp_path):
    messages = []
    for k, (x, y) in enumerate(PLACES.tolist()):
        mine, other = _tag(3, x, y), _tag(9, 5.0, 5.0)
        chosen = {0: [mine, other], 1: [other, mine], 2: [mine]}[k % 3] if k != 5 else [other]
        messages.append({"detections": _list(*chosen)})
    messages[7] = {"detections": []}
    path = _log(tmp_path, _stream("apriltag_msgs/msg/AprilTagDetectionArray", messages))
    _is_there(*_seen(path, TopicSource("/seen", ".detections[:]{id==3}.centre")), hidden=(5, 7))
    with pytest.raises(ConfigError, match=r"holds several places; say which: \{ topic = \"/seen\", path = "):
        _seen(path, TopicSource("/seen"))
    with pytest.raises(LogError, match="shows no place: 11 several places, 1 not in the message"):
        _seen(path, TopicSource("/seen", ".detections[:].corners[:]"))


def test_track_takes_box_centres(tmp_path):
    def box(name: str, x: float, y: float) -> Any:
        point = _message("vision_msgs/msg/Point2D", {"x": x, "y": y})
        pose = _message("vision_msgs/msg/Pose2D", {"position": point, "theta": 0.0})
        shape = _message("vision_msgs/msg/BoundingBox2D", {"center": pose, "size_x": 4.0, "size_y": 4.0})
        return ("vision_msgs/msg/Detection2D", {"header": header(T0), "id": name, "bbox": shape})

    messages = [{"detections": _list(box("mug", 1.0, 2.0), box("hand", x, y))} for x, y in PLACES.tolist()]
    path = _log(tmp_path, _stream("vision_msgs/msg/Detection2DArray", messages))
    for end in ("", ".bbox", ".bbox.center", ".bbox.center.position"):
        _is_there(*_seen(path, TopicSource("/seen", f'.detections[:]{{id=="hand"}}{end}')))


def test_track_takes_the_mean_of_corners(tmp_path):
    def square(x: float, y: float) -> Any:
        around = enumerate([(-3, -2), (3, -2), (3, 2), (-3, 2)])
        corners = {f"{axis}{k}": v for k, (dx, dy) in around for axis, v in (("x", x + dx), ("y", y + dy))}
        return ("fiducial_msgs/msg/Fiducial", {"fiducial_id": 4, "direction": 0, **corners})

    messages = [{"image_seq": 0, "fiducials": _list(square(x, y))} for x, y in PLACES.tolist()]
    path = _log(tmp_path, _stream("fiducial_msgs/msg/FiducialArray", messages))
    _is_there(*_seen(path, TopicSource("/seen", ".fiducials[:]{fiducial_id==4}")))


def test_track_reads_json_at_log_times(tmp_path):
    def message(x: float, y: float) -> bytes:
        return json.dumps({"circles": [{"position": {"x": x, "y": y}}], "points": [], "texts": []}).encode()

    rows = [(ns, message(x, y)) for ns, (x, y) in zip(_stamps(), PLACES.tolist(), strict=True)]
    path = _log(tmp_path, Stream("/marks", "foxglove.ImageAnnotations", b"{}", rows, "json", "jsonschema"))
    track, health = _seen(path, TopicSource("/marks", ".circles[0].position"))
    np.testing.assert_allclose(track.values, PLACES)
    assert health.used == COUNT


def test_track_names_a_missing_topic_or_path(tmp_path):
    points = [{"point": ("geometry_msgs/msg/Point", {"x": x, "y": y, "z": 0.0})} for x, y in PLACES.tolist()]
    path = _log(tmp_path, _stream("geometry_msgs/msg/PointStamped", points))
    with pytest.raises(LogError, match=r"\[features\] tip: there is no topic '/gone'; possible: /joint_states, /seen"):
        _seen(path, TopicSource("/gone"))
    with pytest.raises(ConfigError, match=r"no place at /seen\.pont"):
        _seen(path, TopicSource("/seen", ".pont"))


def test_tracks_read_a_table_beside_the_log(tmp_path):
    path = _log(tmp_path)
    absolute = [f"{ns},{x},{y},0.2" for ns, (x, y) in zip(_stamps(), PLACES.tolist(), strict=True)]
    absolute[4] = f"{_stamps()[4]},,,"
    (tmp_path / "a.csv").write_text("\n".join(["stamp_ns,tip_u,tip_v,tip_std", *reversed(absolute)]) + "\n")
    relative = [f"{k / 10},{x},{y},0.2,0.3" for k, (x, y) in enumerate(PLACES.tolist())]
    (tmp_path / "b.csv").write_text("\n".join(["t,a,b,sa,sb", *relative]) + "\n")
    features = {"tip": TableSource("a.csv"), "other": TableSource("b.csv", ("a", "b", "sa", "sb"))}
    found = observe(path, Settings(features=features))[1]
    np.testing.assert_allclose(found.tracks["other"].values, PLACES)
    np.testing.assert_allclose(found.tracks["other"].std, np.full((COUNT, 2), [0.2, 0.3]))
    np.testing.assert_allclose(found.tracks["tip"].t, np.arange(COUNT) / 10, atol=1e-6)
    assert np.isnan(found.tracks["tip"].values[4]).all() and found.health["tip"].rejected == {"empty": 1}


@pytest.mark.parametrize(
    ("text", "columns", "reason"),
    [
        ("tip_u,tip_v\n1,2\n", None, "has no column of times"),
        ("t,a,b\n0,1,2\n", None, "no column of numbers 'tip_u'; possible: t, a, b"),
        ("t,a,b\n0,1,2\n", ("a",), "columns must name u and v"),
        ("t,tip_u,tip_v\n900,1,2\n", None, "no place within the log"),
        ("t,tip_u,tip_v\n0,,\n", None, "no place within the log"),
    ],
)
def test_tracks_refuse_a_table_in_one_line(tmp_path, text, columns, reason):
    path = _log(tmp_path)
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises((LogError, ConfigError), match=reason) as caught:
        read_recording(path, Settings(features={"tip": TableSource("t.csv", columns)}))
    assert "\n" not in str(caught.value)
    with pytest.raises(LogError, match=r"there is no table 'gone\.csv'"):
        read_recording(path, Settings(features={"tip": TableSource("gone.csv")}))

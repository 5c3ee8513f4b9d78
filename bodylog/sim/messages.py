"""The messages of a recording, built with rosbags, and the message types that this project adds."""

from functools import cache
from typing import Any

import numpy as np

from ..types import Array

DEFINITIONS = {
    "bodylog_msgs/msg/SkinArray": "std_msgs/Header header\nfloat32[] data\n",
    "bodylog_msgs/msg/Touch": (
        "std_msgs/Header header\nbuiltin_interfaces/Duration duration\nint32[] cells\nfloat32 peak\n"
    ),
    "bodylog_msgs/msg/Stroke": (
        "std_msgs/Header header\nbuiltin_interfaces/Duration duration\n"
        "geometry_msgs/Point start\ngeometry_msgs/Point end\nfloat64 delay\n"
    ),
}
"""Definitions that ROS 2 lacks; Stroke: start, end in px (z unused), delay = seen − felt in s."""

_SECOND = 1_000_000_000


@cache
def store() -> Any:
    """The type store with ROS 2's types and ours."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        types.register(get_types_from_msg(text, name))
    return types


def definition(kind: str) -> bytes:
    """The definition of a type with all it depends on, in the ros2msg dialect."""
    return str(store().generate_msgdef(kind, ros_version=2)[0]).encode()


def _make(kind: str, *fields: Any) -> Any:
    return store().types[kind](*fields)


def _time(ns: int, kind: str = "builtin_interfaces/msg/Time") -> Any:
    return _make(kind, ns // _SECOND, ns % _SECOND)


def _header(ns: int, frame: str) -> Any:
    return _make("std_msgs/msg/Header", _time(ns), frame)


def _duration(seconds: float) -> Any:
    return _time(round(seconds * _SECOND), "builtin_interfaces/msg/Duration")


def _point(values: Array) -> Any:
    return _make("geometry_msgs/msg/Point", *(float(value) for value in values))


def _quaternion(xyzw: Array) -> Any:
    return _make("geometry_msgs/msg/Quaternion", *(float(value) for value in xyzw))


def joint_state(ns: int, names: list[str], position: Array, velocity: Array) -> Any:
    """sensor_msgs/JointState in rad and rad/s; effort 0, because nothing simulates forces (pybag needs the field)."""
    effort = np.zeros(len(names))
    return _make("sensor_msgs/msg/JointState", _header(ns, "base_link"), names, position, velocity, effort)


def skin_array(ns: int, data: Array) -> Any:
    """bodylog_msgs/SkinArray: data (cells,) float32 in 0..1."""
    return _make("bodylog_msgs/msg/SkinArray", _header(ns, "skin"), data)


def compressed(ns: int, frame: str, jpeg: Array) -> Any:
    """sensor_msgs/CompressedImage."""
    return _make("sensor_msgs/msg/CompressedImage", _header(ns, frame), "jpeg", jpeg)


def raw(ns: int, frame: str, picture: Array) -> Any:
    """sensor_msgs/Image in rgb8 from an image (H,W,3) uint8 RGB."""
    height, width = picture.shape[:2]
    fields = (height, width, "rgb8", 0, 3 * width, np.ascontiguousarray(picture).ravel())
    return _make("sensor_msgs/msg/Image", _header(ns, frame), *fields)


def camera_info(ns: int, frame: str, width: int, height: int, focal: float, centre: tuple[float, float]) -> Any:
    """sensor_msgs/CameraInfo of a pinhole without distortion."""
    k = np.array([focal, 0, centre[0], 0, focal, centre[1], 0, 0, 1.0])
    p = np.insert(k, [3, 6, 9], 0.0)
    roi = _make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
    fields = (height, width, "plumb_bob", np.zeros(5), k, np.eye(3).ravel(), p, 0, 0, roi)
    return _make("sensor_msgs/msg/CameraInfo", _header(ns, frame), *fields)


def pose(ns: int, position: Array, xyzw: Array) -> Any:
    """geometry_msgs/PoseStamped in the base frame."""
    inner = _make("geometry_msgs/msg/Pose", _point(position), _quaternion(xyzw))
    return _make("geometry_msgs/msg/PoseStamped", _header(ns, "base_link"), inner)


def pixel(ns: int, frame: str, uv: Array) -> Any:
    """geometry_msgs/PointStamped: x = u px, y = v px."""
    return _make("geometry_msgs/msg/PointStamped", _header(ns, frame), _point(np.append(uv, 0.0)))


def touch(ns: int, seconds: float, cells: Array, peak: float) -> Any:
    """bodylog_msgs/Touch: `ns` is the onset."""
    return _make("bodylog_msgs/msg/Touch", _header(ns, "skin"), _duration(seconds), cells.astype(np.int32), peak)


def stroke(ns: int, frame: str, seconds: float, start: Array, end: Array, delay: float) -> Any:
    """bodylog_msgs/Stroke: `ns` is the contact's start in the image; start, end (2,) px; delay s."""
    points = (_point(np.append(start, 0.0)), _point(np.append(end, 0.0)))
    return _make("bodylog_msgs/msg/Stroke", _header(ns, frame), _duration(seconds), *points, delay)


def transforms(ns: int, frames: list[tuple[str, Array, Array]], parent: str = "base_link") -> Any:
    """tf2_msgs/TFMessage: (child, position m, orientation xyzw) each in the frame of `parent`."""
    return _make("tf2_msgs/msg/TFMessage", [_transform(ns, parent, *frame) for frame in frames])


def _transform(ns: int, parent: str, child: str, position: Array, xyzw: Array) -> Any:
    place = _make("geometry_msgs/msg/Vector3", *(float(value) for value in position))
    inner = _make("geometry_msgs/msg/Transform", place, _quaternion(xyzw))
    return _make("geometry_msgs/msg/TransformStamped", _header(ns, parent), child, inner)


def text(words: str) -> Any:
    """std_msgs/String."""
    return _make("std_msgs/msg/String", words)

"""The messages of a recording, built with rosbags, and the message types that this project adds."""

from functools import cache
from typing import Any

import numpy as np

from ..types import Array

DEFINITIONS = {
    "bodylog_msgs/msg/SkinArray": "std_msgs/Header header\nfloat32[] data\n",
    "bodylog_msgs/msg/Touch": (
        "std_msgs/Header header\nbuiltin_interfaces/Duration duration\nint32[] "
        "cells\nfloat32 peak\n"
    ),
    "bodylog_msgs/msg/Stroke": (
        "std_msgs/Header header\nbuiltin_interfaces/Duration duration\n"
        "geometry_msgs/Point start\ngeometry_msgs/Point end\nfloat64 delay\n"
    ),
}
"""Definitions that ROS 2 lacks; Stroke: start, end in px (z unused), delay = seen − felt in s."""

_SECOND = 1_000_000_000


@cache
def type_store() -> Any:
    """The type store with ROS 2's types and ours."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        types.register(get_types_from_msg(text, name))
    return types


def message_definition(kind: str) -> bytes:
    """The definition of a type with all it depends on, in the ros2msg dialect."""
    return str(type_store().generate_msgdef(kind, ros_version=2)[0]).encode()


def _make_message(kind: str, *fields: Any) -> Any:
    return type_store().types[kind](*fields)


def _time_message(ns: int, kind: str = "builtin_interfaces/msg/Time") -> Any:
    return _make_message(kind, ns // _SECOND, ns % _SECOND)


def _header_message(ns: int, frame: str) -> Any:
    return _make_message("std_msgs/msg/Header", _time_message(ns), frame)


def _duration_message(seconds: float) -> Any:
    return _time_message(round(seconds * _SECOND), "builtin_interfaces/msg/Duration")


def _point_message(values: Array) -> Any:
    return _make_message("geometry_msgs/msg/Point", *(float(value) for value in values))


def _quaternion_message(xyzw: Array) -> Any:
    return _make_message("geometry_msgs/msg/Quaternion", *(float(value) for value in xyzw))


def joint_state(ns: int, names: list[str], position: Array, velocity: Array) -> Any:
    """sensor_msgs/JointState in rad and rad/s; effort 0,
    because nothing simulates forces (pybag needs the field).
    """
    effort = np.zeros(len(names))
    return _make_message(
        "sensor_msgs/msg/JointState",
        _header_message(ns, "base_link"),
        names,
        position,
        velocity,
        effort,
    )


def skin_array(ns: int, data: Array) -> Any:
    """bodylog_msgs/SkinArray: data (cells,) float32 in 0..1."""
    return _make_message("bodylog_msgs/msg/SkinArray", _header_message(ns, "skin"), data)


def compressed_image(ns: int, frame: str, jpeg: Array) -> Any:
    """sensor_msgs/CompressedImage."""
    return _make_message(
        "sensor_msgs/msg/CompressedImage", _header_message(ns, frame), "jpeg", jpeg
    )


def raw_image(ns: int, frame: str, picture: Array) -> Any:
    """sensor_msgs/Image in rgb8 from an image (H,W,3) uint8 RGB."""
    height, width = picture.shape[:2]
    fields = (height, width, "rgb8", 0, 3 * width, np.ascontiguousarray(picture).ravel())
    return _make_message("sensor_msgs/msg/Image", _header_message(ns, frame), *fields)


def camera_info_message(
    ns: int, frame: str, width: int, height: int, focal: float, centre: tuple[float, float]
) -> Any:
    """sensor_msgs/CameraInfo of a pinhole without distortion."""
    k = np.array([focal, 0, centre[0], 0, focal, centre[1], 0, 0, 1.0])
    p = np.insert(k, [3, 6, 9], 0.0)
    roi = _make_message("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
    fields = (height, width, "plumb_bob", np.zeros(5), k, np.eye(3).ravel(), p, 0, 0, roi)
    return _make_message("sensor_msgs/msg/CameraInfo", _header_message(ns, frame), *fields)


def pose_message(ns: int, position: Array, xyzw: Array) -> Any:
    """geometry_msgs/PoseStamped in the base frame."""
    inner = _make_message(
        "geometry_msgs/msg/Pose", _point_message(position), _quaternion_message(xyzw)
    )
    return _make_message("geometry_msgs/msg/PoseStamped", _header_message(ns, "base_link"), inner)


def pixel_message(ns: int, frame: str, uv: Array) -> Any:
    """geometry_msgs/PointStamped: x = u px, y = v px."""
    return _make_message(
        "geometry_msgs/msg/PointStamped",
        _header_message(ns, frame),
        _point_message(np.append(uv, 0.0)),
    )


def touch_message(ns: int, seconds: float, cells: Array, peak: float) -> Any:
    """bodylog_msgs/Touch: `ns` is the onset."""
    return _make_message(
        "bodylog_msgs/msg/Touch",
        _header_message(ns, "skin"),
        _duration_message(seconds),
        cells.astype(np.int32),
        peak,
    )


def stroke_message(
    ns: int, frame: str, seconds: float, start: Array, end: Array, delay: float
) -> Any:
    """bodylog_msgs/Stroke: `ns`: the contact's start in the image; start, end (2,) px; delay s."""
    points = (_point_message(np.append(start, 0.0)), _point_message(np.append(end, 0.0)))
    return _make_message(
        "bodylog_msgs/msg/Stroke",
        _header_message(ns, frame),
        _duration_message(seconds),
        *points,
        delay,
    )


def transforms_message(
    ns: int, frames: list[tuple[str, Array, Array]], parent: str = "base_link"
) -> Any:
    """tf2_msgs/TFMessage: (child, position m, orientation xyzw) each in the frame of `parent`."""
    return _make_message(
        "tf2_msgs/msg/TFMessage", [_transform_message(ns, parent, *frame) for frame in frames]
    )


def _transform_message(ns: int, parent: str, child: str, position: Array, xyzw: Array) -> Any:
    place = _make_message("geometry_msgs/msg/Vector3", *(float(value) for value in position))
    inner = _make_message("geometry_msgs/msg/Transform", place, _quaternion_message(xyzw))
    return _make_message(
        "geometry_msgs/msg/TransformStamped", _header_message(ns, parent), child, inner
    )


def text_message(words: str) -> Any:
    """std_msgs/String."""
    return _make_message("std_msgs/msg/String", words)

"""The message types that bodylog writes, as complete ros2msg text."""

_PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/PointStamped": "std_msgs/Header header\ngeometry_msgs/Point point\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
    "geometry_msgs/PoseWithCovarianceStamped": "std_msgs/Header "
    "header\ngeometry_msgs/PoseWithCovariance "
    "pose\n",
    "sensor_msgs/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] "
        "velocity\nfloat64[] effort\n"
    ),
    "bodylog_msgs/Touch": (
        "# One touch on the skin: the stamp is its onset; the strongest cell comes first.\n"
        "std_msgs/Header header\nbuiltin_interfaces/Duration duration\nint32[] "
        "cells\nfloat32 peak\n"
    ),
    "bodylog_msgs/Stroke": (
        "# One stroke of the hand as seen: the stamp is its start; start, end in px (z unused).\n"
        "# delay = seen - felt in s (NaN: nothing felt).\n"
        "std_msgs/Header header\nbuiltin_interfaces/Duration duration\n"
        "geometry_msgs/Point start\ngeometry_msgs/Point end\nfloat64 delay\n"
    ),
    "bodylog_msgs/Synchrony": (
        "# How well a touch agrees with a stroke that was seen: delay = seen - felt in s (NaN: "
        "nothing seen), weight 0..1.\n"
        "std_msgs/Header header\nfloat64 delay\nfloat64 weight\n"
    ),
    "bodylog_msgs/Covariance": (
        "# Covariance of the named quantities, row by row.\nstd_msgs/Header header\nstring[] "
        "names\nfloat64[] data\n"
    ),
    "bodylog_msgs/Vector": "std_msgs/Header header\nstring[] names\nfloat64[] data\n",
    "bodylog_msgs/Scalar": "std_msgs/Header header\nfloat64 data\n",
    "bodylog_msgs/SkinArray": "# Proximity of each cell, "
    "0..1.\nstd_msgs/Header header\nfloat32[] data\n",
    "bodylog_msgs/Fault": (
        "# A sensor that lied since header.stamp: by `size` +- `std` in `unit` (NaN: not known).\n"
        "std_msgs/Header header\nstring sense\nstring name\nstring kind\nfloat64 "
        "size\nstring unit\nfloat64 std\n"
        "# A moved board also turned by `turn` +- `turn_std` rad (NaN: no board, or not known).\n"
        "float64 turn\nfloat64 turn_std\n"
        "# When it ended, s since the log's first joint reading (NaN: it lasted, or is a jump).\n"
        "float64 until\n"
    ),
    "foxglove_msgs/Color": "float64 r\nfloat64 g\nfloat64 b\nfloat64 a\n",
    "foxglove_msgs/Point2": "float64 x\nfloat64 y\n",
    "foxglove_msgs/CircleAnnotation": (
        "builtin_interfaces/Time timestamp\nfoxglove_msgs/Point2 position\nfloat64 "
        "diameter\nfloat64 thickness\n"
        "foxglove_msgs/Color fill_color\nfoxglove_msgs/Color outline_color\n"
    ),
    "foxglove_msgs/PointsAnnotation": (
        "builtin_interfaces/Time timestamp\n"
        "uint8 UNKNOWN=0\nuint8 POINTS=1\nuint8 LINE_LOOP=2\nuint8 LINE_STRIP=3\nuint8 "
        "LINE_LIST=4\n"
        "uint8 type\nfoxglove_msgs/Point2[] points\nfoxglove_msgs/Color outline_color\n"
        "foxglove_msgs/Color[] outline_colors\nfoxglove_msgs/Color fill_color\nfloat64 thickness\n"
    ),
    "foxglove_msgs/TextAnnotation": (
        "builtin_interfaces/Time timestamp\nfoxglove_msgs/Point2 position\nstring "
        "text\nfloat64 font_size\n"
        "foxglove_msgs/Color text_color\nfoxglove_msgs/Color background_color\n"
    ),
    "foxglove_msgs/ImageAnnotations": (
        "foxglove_msgs/CircleAnnotation[] circles\nfoxglove_msgs/PointsAnnotation[] points\n"
        "foxglove_msgs/TextAnnotation[] texts\n"
    ),
}
_HEADER = ("std_msgs/Header", "builtin_interfaces/Time")
_NEEDS = {
    "geometry_msgs/PointStamped": ("geometry_msgs/Point", *_HEADER),
    "geometry_msgs/PoseWithCovarianceStamped": (
        "geometry_msgs/PoseWithCovariance",
        "geometry_msgs/Pose",
        "geometry_msgs/Point",
        "geometry_msgs/Quaternion",
        *_HEADER,
    ),
    "sensor_msgs/JointState": _HEADER,
    "bodylog_msgs/Touch": (*_HEADER, "builtin_interfaces/Duration"),
    "bodylog_msgs/Stroke": (*_HEADER, "builtin_interfaces/Duration", "geometry_msgs/Point"),
    "bodylog_msgs/Synchrony": _HEADER,
    "bodylog_msgs/Covariance": _HEADER,
    "bodylog_msgs/Vector": _HEADER,
    "bodylog_msgs/Scalar": _HEADER,
    "bodylog_msgs/SkinArray": _HEADER,
    "bodylog_msgs/Fault": _HEADER,
    "foxglove_msgs/ImageAnnotations": (
        "foxglove_msgs/CircleAnnotation",
        "foxglove_msgs/PointsAnnotation",
        "foxglove_msgs/TextAnnotation",
        "foxglove_msgs/Color",
        "foxglove_msgs/Point2",
        "builtin_interfaces/Time",
    ),
}
WRITTEN = tuple(name.replace("/", "/msg/") for name in _NEEDS)
"""The types, as package/msg/Name."""


def ros2msg_definition(name: str) -> bytes:
    """The ros2msg text of package/msg/Name, followed by every type it needs."""
    short = name.replace("/msg/", "/")
    parts = [_PARTS[short]]
    parts += [f"{'=' * 80}\nMSG: {need}\n{_PARTS[need]}" for need in _NEEDS[short]]
    return "".join(parts).encode()

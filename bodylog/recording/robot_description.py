"""The robot description in a log: its URDF, fixed transforms, camera calibrations."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import BodylogError
from ..logs.decode.columns import choose_column_decoder, is_ros1
from ..logs.decode.parts import TopicColumns
from ..logs.formats import open_log
from ..logs.limits import LIMITS, Input
from ..logs.protocol import Log
from ..types import Array, Batch, Topic

_MANY = 50
"""Messages of fixed transforms to read: several nodes may publish some."""
_TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_POSE = "transforms[:].transform."
_FIELDS = {
    "translation": tuple(f"{_POSE}translation.{axis}" for axis in "xyz"),
    "rotation": tuple(f"{_POSE}rotation.{axis}" for axis in "xyzw"),
}


@dataclass(frozen=True, eq=False)
class CameraInfo:
    """A sensor_msgs/CameraInfo: frame · width, height px ·
    matrix (9,) px, row-major · distortion (K,) of its model.
    """

    frame: str
    width: int
    height: int
    matrix: Array
    distortion: Array
    model: str


@dataclass(frozen=True, eq=False)
class Described:
    """urdf: the text of /robot_description · transforms {child:
    (parent, pose (4,4) m)} · cameras {topic: its info}.

    joints: the names in the first message of each topic of joint states.
    """

    urdf: str | None
    transforms: Mapping[str, tuple[str, Array]]
    cameras: Mapping[str, CameraInfo]
    joints: tuple[str, ...] = ()


def read_robot_description(path: Path, limits: Input = LIMITS) -> Described:
    """The robot description in a log of any format; empty for a table, or without one."""
    with open_log(path, limits=limits) as log:
        topics = {
            topic.id: topic for topic in log.topics if _kind_of_description(topic) is not None
        }
        found = _read_first_messages(log, topics)
    texts = [
        c.column("data")
        for id_, c in found.items()
        if _kind_of_description(topics[id_]) == "description"
    ]
    transforms: dict[str, tuple[str, Array]] = {}
    for id_, columns in found.items():
        if _kind_of_description(topics[id_]) == "transforms":
            transforms |= _transforms_by_child(columns)
    cameras = {
        topics[id_].name: _camera_info_of_columns(c)
        for id_, c in found.items()
        if _kind_of_description(topics[id_]) == "camera"
    }
    urdf = next((str(text.reshape(-1)[-1]) for text in texts if len(text)), None)
    known = {name: camera for name, camera in cameras.items() if camera is not None}
    names = [
        c.column("name")
        for id_, c in found.items()
        if _kind_of_description(topics[id_]) == "joints"
    ]
    joints = dict.fromkeys(
        str(name) for part in names if len(part) for name in np.ravel(part[0]) if name is not None
    )
    return Described(urdf, transforms, known, tuple(joints))


def _kind_of_description(topic: Topic) -> str | None:
    if topic.type == "std_msgs/msg/String" and topic.name.endswith("robot_description"):
        return "description"
    if topic.type in _TF and topic.name.endswith("tf_static"):
        return "transforms"
    if topic.type == "sensor_msgs/msg/JointState":
        return "joints"
    return "camera" if topic.type == "sensor_msgs/msg/CameraInfo" else None


def _read_first_messages(log: Log, topics: Mapping[int, Topic]) -> dict[int, TopicColumns]:
    """The first messages of some topics; reading stops there."""
    wanted = {
        id_: _MANY if _kind_of_description(topic) == "transforms" else 1
        for id_, topic in topics.items()
    }
    left = {id_: min(count, max(topics[id_].messages, 1)) for id_, count in wanted.items()}
    decoders = {}
    for id_, topic in topics.items():
        with suppress(BodylogError):  # an unreadable definition describes nothing
            decoders[id_] = choose_column_decoder(topic, _fields_of_description(topic))
    left = {id_: count for id_, count in left.items() if id_ in decoders}
    for batch in log.batches(tuple(left)) if left else ():
        count = min(left.get(batch.topic_id, 0), len(batch.log_ns))
        if count:
            rows = slice(count)
            part = Batch(
                batch.topic_id,
                batch.log_ns[rows],
                batch.data,
                batch.offset[rows],
                batch.length[rows],
            )
            decoders[batch.topic_id].feed(part)
            left[batch.topic_id] -= count
        if not any(left.values()):
            break
    return {id_: one.columns() for id_, one in decoders.items()}


def _fields_of_description(topic: Topic) -> Sequence[str]:
    kind = _kind_of_description(topic)
    if kind == "description":
        return ("data",)
    if kind == "joints":
        return ("name",)
    if kind == "transforms":
        names = ("transforms[:].header.frame_id", "transforms[:].child_frame_id")
        return (*names, *_FIELDS["translation"], *_FIELDS["rotation"])
    matrix, distortion = ("K", "D") if is_ros1(topic) else ("k", "d")
    return ("header.frame_id", "width", "height", "distortion_model", matrix, distortion)


def _transforms_by_child(columns: TopicColumns) -> dict[str, tuple[str, Array]]:
    found = {}
    for part in columns.parts:
        parents, children, *numbers = part.values
        values = np.stack([np.asarray(v).reshape(len(part.rows), -1) for v in numbers], axis=-1)
        for row in values:
            for parent, child, (x, y, z, *quaternion) in zip(parents, children, row, strict=True):
                pose = np.eye(4)
                pose[:3, :3] = _rotation_from_quaternion(np.array(quaternion))
                pose[:3, 3] = (x, y, z)
                if np.isfinite(pose).all():
                    found[str(child).lstrip("/")] = str(parent).lstrip("/"), pose
    return found


def _rotation_from_quaternion(quaternion: Array) -> Array:
    """Rotation (3,3) of a quaternion x, y, z, w; NaN if its length is zero."""
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _camera_info_of_columns(columns: TopicColumns) -> CameraInfo | None:
    """The first message, if the camera is calibrated."""
    if not columns.parts:
        return None
    frame, width, height, model, matrix, distortion = (
        columns.column(name)[0] for name in columns.fields
    )
    matrix = np.asarray(matrix, float).reshape(-1)
    distortion = np.asarray(distortion, float).reshape(-1)
    if len(matrix) != 9 or not np.isfinite(matrix).all() or matrix[0] <= 0 or matrix[4] <= 0:
        return None
    text, kind = (str(np.asarray(one).reshape(-1)[0]) for one in (frame, model))
    return CameraInfo(
        text.lstrip("/"), int(width), int(height), matrix, distortion[np.isfinite(distortion)], kind
    )

"""A table of measured poses as a log: its rows become messages."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from ...errors import BodylogError, FormatError, LogError
from ...io.contained import file_inside
from ..decode.ros1_to_cdr import known_definition
from ..encode import cdr
from ..encode.cdr import CdrField
from ..encode.schemas import ros2msg_definition
from ..images.codecs import check_size, stated_size
from ..joint_units import UNIT
from ..limits import LIMITS, Input
from ..records import Array, Batch, Finding, Outgoing, Topic
from ..topics import INDEPENDENT, POINT_NAMES, TRACK, TRACK_NAMES, escape_topic_name
from .frame_columns import frame_of
from .pose_columns import (
    DISTORTION,
    IMAGES,
    LENS,
    SIZE,
    PoseColumns,
    assign_column_roles,
    in_degrees,
)
from .table_file import read_table_file, table_format

JOINTS = "/joint_states"
JOINT_STATE = "sensor_msgs/msg/JointState"
VECTOR = "bodylog_msgs/msg/Vector"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
_LARGEST = 64 << 20
_AS_THEY_ARE = (".jpg", ".jpeg", ".png", ".webp")


class PoseLog:
    """A CSV, Parquet or YAML table of poses; see protocol.Log."""

    def __init__(
        self, path: Path, strict: bool = False, source: Path | None = None, limits: Input = LIMITS
    ) -> None:
        """Read the whole table `source` (default: `path`); LogError when it holds no poses."""
        source = source or path
        self.path = path
        with source.open("rb") as stream:
            self.format = table_format(path, stream.read(4)) or "csv"
        table = read_table_file(source, self.format, limits)
        self._strict = strict
        self._findings = list[Finding]()
        self._mpx = limits.max_image_mpx
        found = assign_column_roles(table, str(path))
        self._add("info", *found.notes)
        self._add("warning", *table.odd, *found.odd)
        self._add("lost", *table.lost)
        if far := in_degrees(found.joints):
            text = (
                f"{', '.join(far)}: more than two turns; are these degrees? type: [body] unit = "
                '"deg"'
            )
            self._add("warning", text)
        first = found.t.min()
        # a stamp of zero means no stamp, so times begin a second after it
        t = found.t if first >= 1.0 else found.t - first + 1.0
        self._ns = np.rint(t * 1e9).astype(np.int64)
        self._outgoing = [
            *self._joints(found.joints),
            *self._tracks(found.tracks, found.std),
            *self._lens(found),
        ]
        self._images = {
            len(self._outgoing) + k: files for k, files in enumerate(found.images.values())
        }
        cameras = zip(self._images.items(), found.images, strict=True)
        self.topics: tuple[Topic, ...] = (
            *(
                _describe_pose_topic(k, out, tuple(found.joints))
                for k, out in enumerate(self._outgoing)
            ),
            *(
                _describe_pose_camera(k, name, sum(map(bool, files)))
                for (k, files), name in cameras
            ),
        )
        self.start_ns = int(self._ns.min())
        self.end_ns = int(self._ns.max())

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The roles of the columns, and what is wrong with the rows."""
        return tuple(dict.fromkeys(self._findings))

    def batches(self, ids: Collection[int] | None = None) -> Iterator[Batch]:
        """Messages of the topics `ids` (None: all), one
        topic after the other; images are read one by one.
        """
        for number, out in enumerate(self._outgoing):
            if ids is None or number in ids:
                yield Batch(number, out.log_ns, out.data, out.offset, out.length)
        for number, files in self._images.items():
            if ids is None or number in ids:
                yield from self._files(number, files)

    def spans(self) -> dict[int, tuple[int, int]]:
        """First and last time (ns) of every topic."""
        return {topic.id: (self.start_ns, self.end_ns) for topic in self.topics}

    def close(self) -> None:
        """Do nothing: no file stays open."""

    def __enter__(self) -> "PoseLog":
        """Return the log."""
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing: no file stays open."""

    def _add(self, severity: str, *texts: str) -> None:
        """Add findings; LogError for a loss if the log is read strictly."""
        if severity == "lost" and texts and self._strict:
            raise LogError(
                f"{self.path}: {texts[0]}; type the command without --strict to use the rest"
            )
        self._findings += [Finding(severity, f"{self.path}: {text}") for text in texts]

    def _joints(self, joints: Mapping[str, Array]) -> list[Outgoing]:
        if not joints:
            return []
        values = np.column_stack(list(joints.values()))
        # NaN where ROS would leave the array empty: pybag
        # cannot read a message that ends in an empty array.
        unknown = np.full(values.shape, np.nan)
        rows: list[CdrField] = [
            ("float64[]", values),
            ("float64[]", unknown),
            ("float64[]", unknown),
        ]
        return [
            self._outgoing_of(
                JOINTS,
                JOINT_STATE,
                [*cdr.cdr_header_field(self._ns), ("string[]", tuple(joints)), *rows],
            )
        ]

    def _tracks(self, tracks: Mapping[str, Array], std: Mapping[str, Array]) -> Iterator[Outgoing]:
        for name, places in tracks.items():
            data = np.hstack([places, std.get(name, np.full(places.shape, np.nan))])
            fields: list[CdrField] = [
                *cdr.cdr_header_field(self._ns),
                ("string[]", TRACK_NAMES if places.shape[1] == 2 else POINT_NAMES),
                ("float64[]", data),
            ]
            yield self._outgoing_of(TRACK + escape_topic_name(name), VECTOR, fields)

    def _lens(self, found: PoseColumns) -> Iterator[Outgoing]:
        """The lens of the camera, as its CameraInfo at the first row."""
        if not found.lens:
            return
        camera = escape_topic_name(next(iter(found.images), "camera"))
        fx, fy, cx, cy = (found.lens[name] for name in LENS)
        radial = [found.lens.get(name, 0.0) for name in DISTORTION]
        width, height = (round(found.lens.get(name, 0.0)) for name in SIZE)
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        projection = np.hstack([matrix, np.zeros((3, 1))])
        fields: list[CdrField] = [
            *cdr.cdr_header_field(self._ns[:1]),
            ("uint32", height),
            ("uint32", width),
            ("string", "plumb_bob"),
            ("float64[]", np.array([radial])),
            *(("float64*", one.reshape(1, -1)) for one in (matrix, np.eye(3), projection)),
            *[("uint32", 0)] * 6,
            ("bool", 0),
        ]
        made = cdr.serialise_messages(1, fields)
        topic = f"/{camera}/camera_info"
        text = known_definition(CAMERA_INFO) or b""
        stamps = self._ns[:1]
        yield Outgoing(topic, CAMERA_INFO, text, stamps, made.data, made.offset, made.length)

    def _outgoing_of(self, topic: str, kind: str, fields: Sequence[CdrField]) -> Outgoing:
        made = cdr.serialise_messages(len(self._ns), fields)
        return Outgoing(
            topic, kind, ros2msg_definition(kind), self._ns, made.data, made.offset, made.length
        )

    def _files(self, number: int, files: Array) -> Iterator[Batch]:
        """One batch per image; a missing or too large file is counted as lost."""
        missing: list[str] = []
        for ns, name in zip(self._ns.tolist(), files.tolist(), strict=True):
            if not name:
                continue
            data = self._image(str(name))
            if data is None:
                missing.append(str(name))
                continue
            made = cdr.serialise_messages(1, _pose_image_fields(ns, data))
            yield Batch(number, np.array([ns]), made.data, made.offset, made.length)
        if missing:
            text = f"{len(missing)} images cannot be read: {', '.join(missing[:3])}"
            self._add("lost", f"{text}; only those in the table's folder are")

    def _image(self, name: str) -> Array | None:
        """The bytes of an image in the table's folder, as
        PNG unless JPEG, PNG or WebP; None: unreadable.
        """
        file = file_inside(self.path.parent, name)
        try:
            if file is None or not 0 < file.stat().st_size <= _LARGEST:
                return None
            data = np.fromfile(file, np.uint8)
        except (OSError, ValueError):
            return None
        if file.suffix.lower() in _AS_THEY_ARE:
            return data
        try:
            return _as_png(data, self._mpx)
        except FormatError as problem:
            self._add("lost", f"{name}: {problem}")
            return None


def image_files(path: Path) -> tuple[Path, ...]:
    """The image files that a table of poses names; none for any other file."""
    if not path.is_file() or (form := table_format(path)) is None:
        return ()
    if form != "parquet":
        with path.open("rb") as stream:
            text = stream.read(int(1e6 * LIMITS.max_table_mb)).lower()
        # YAML may spell a name with escapes, such as "\x2ejpg"
        named = any(name.encode() in text for name in IMAGES) or (form == "yaml" and b"\\" in text)
        if not named:
            return ()
    try:
        found = assign_column_roles(read_table_file(path, form), str(path)).images
    except BodylogError:
        return ()
    return tuple(
        path.parent / str(name) for files in found.values() for name in files.tolist() if name
    )


def _as_png(data: Array, mpx: float) -> Array | None:
    """An image as PNG, None where it cannot be decoded;
    FormatError where it states more than `mpx` million pixels.
    """
    import cv2

    check_size(*stated_size(memoryview(data.tobytes())), mpx)
    image = cv2.imdecode(data, cv2.IMREAD_COLOR)
    return None if image is None else np.asarray(cv2.imencode(".png", image)[1]).reshape(-1)


def _describe_pose_topic(number: int, out: Outgoing, joints: tuple[str, ...]) -> Topic:
    metadata = INDEPENDENT if out.topic == JOINTS else {}
    if metadata and frame_of(joints) is not None:
        # coordinates of a frame are in m and rad, whatever the unit of a robot's joints is
        metadata = {**metadata, UNIT: "rad"}
    return Topic(
        number, out.topic, out.type, "cdr", out.definition, "ros2msg", len(out.log_ns), metadata
    )


def _describe_pose_camera(number: int, column: str, images: int) -> Topic:
    text = known_definition(COMPRESSED) or b""
    return Topic(
        number,
        f"/{escape_topic_name(column)}/compressed",
        COMPRESSED,
        "cdr",
        text,
        "ros2msg",
        images,
    )


def _pose_image_fields(ns: int, data: Array) -> list[CdrField]:
    form = "png" if bytes(data[:4]) == b"\x89PNG" else "jpeg"
    return [*cdr.cdr_header_field(np.array([ns])), ("string", form), ("uint8[]", data[None])]

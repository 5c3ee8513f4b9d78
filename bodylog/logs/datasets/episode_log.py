"""One episode of a dataset as a log: signals held as
arrays, cameras decoded on reading; see protocol.Log.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import numpy as np

from ...errors import LogError
from ..decode.ros1_to_cdr import known_definition
from ..encode import cdr
from ..encode.cdr import CdrField, Payloads
from ..encode.schemas import ros2msg_definition
from ..records import Array, Batch, Finding, Topic

JOINTS = "/joint_states"
ACTION = "/action"
FEATURE = "bodylog.feature"
DTYPE = "bodylog.dtype"
"""Metadata of a topic: the dataset's name and dtype of its values."""
JOINT_STATE = "sensor_msgs/msg/JointState"
VECTOR = "bodylog_msgs/msg/Vector"
RAW = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
TEXT = "std_msgs/msg/String"
EPOCH_NS = 1_000_000_000
"""Start of times that count from an episode's start: a stamp of 0 would mean no stamp."""
_BATCH_BYTES = 4 << 20

_DEPTH = re.compile(r"(^|[._/])depth([._/]|$)")

Item = tuple[int, Array | bytes | None]
"""Number of a frame, and its image (H,W,3) uint8 BGR or encoded bytes; None if unreadable."""


def is_named_depth(name: str) -> bool:
    """Whether a feature's name says that it holds depth."""
    return bool(_DEPTH.search(name))


@dataclass(frozen=True, eq=False)
class EpisodeSignal:
    """Numbers of one topic: values (N,K) float64 at ns (N,) int64, as JointState or Vector."""

    topic: str
    type: str
    names: tuple[str, ...]
    values: Array
    ns: Array
    metadata: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Texts:
    """Texts of one topic: texts (N,) at ns (N,) int64, as std_msgs/String."""

    topic: str
    texts: tuple[str, ...]
    ns: Array
    metadata: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class EpisodeCamera:
    """Images of one topic: their times ns (n,) int64, and
    a function that reads one item per time, in order.

    `read_grey` reads them as grey images (H,W) uint8, which costs less; None where images are
    encoded one by one. `size` is (width, height) px of raw images; None: encoded in the format
    `form` (jpeg, png).
    """

    topic: str
    ns: Array
    read: Callable[[], Iterator[Item]]
    size: tuple[int, int] | None
    form: str = ""
    metadata: Mapping[str, str] = field(default_factory=dict)
    read_grey: Callable[[], Iterator[Item]] | None = None


@dataclass(frozen=True, eq=False)
class Episode:
    """The result of a reader: format name, streams, findings; `length`: declared number of rows."""

    format: str
    streams: Sequence[EpisodeSignal | Texts | EpisodeCamera]
    findings: Sequence[Finding] = ()
    length: int | None = None


class EpisodeLog:
    """An episode as a log; unreadable images count as lost and become messages without an image."""

    def __init__(self, path: Path, episode: Episode, strict: bool) -> None:
        """LogError for an empty episode, or when strict and part of it is lost."""
        self.path = path
        self.episode = episode
        self.format = episode.format
        self._strict = strict
        self._lost: dict[str, str] = {}
        streams = [one for one in episode.streams if len(one.ns)]
        if not streams:
            lost = next((one.text for one in episode.findings if one.severity == "lost"), "")
            raise LogError(f"{path}: the episode is empty: {lost or 'no rows and no images'}")
        self._streams = dict(enumerate(streams))
        self.topics: tuple[Topic, ...] = tuple(
            _describe_episode_topic(number, one) for number, one in self._streams.items()
        )
        self.start_ns = min(int(one.ns.min()) for one in streams)
        self.end_ns = max(int(one.ns.max()) for one in streams)
        for finding in episode.findings:
            self._refuse(finding)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings of the reader, and the unreadable images so far."""
        lost = (Finding("lost", f"{self.path}: {text}") for text in self._lost.values())
        return (
            *(Finding(f.severity, f"{self.path}: {f.text}") for f in self.episode.findings),
            *lost,
        )

    @property
    def cameras(self) -> dict[int, EpisodeCamera]:
        """The cameras by topic id."""
        return {
            number: one for number, one in self._streams.items() if isinstance(one, EpisodeCamera)
        }

    @property
    def signals(self) -> tuple[EpisodeSignal, ...]:
        """The topics of numbers."""
        return tuple(one for one in self._streams.values() if isinstance(one, EpisodeSignal))

    def batches(self, ids: Collection[int] | None = None) -> Iterator[Batch]:
        """Messages of the topics `ids` (None: all), one
        topic after the other; images a few MiB at a time.
        """
        for number, one in self._streams.items():
            if ids is None or number in ids:
                yield from (
                    self._images(number, one)
                    if isinstance(one, EpisodeCamera)
                    else _iterate_stored_messages(number, one)
                )

    def heads(self, ids: Collection[int] | None = None) -> Iterator[Batch]:
        """As `batches`, but messages of cameras have no images, so that none is decoded."""
        for number, one in self._streams.items():
            if ids is None or number in ids:
                yield from _iterate_stored_messages(number, one)

    def spans(self) -> dict[int, tuple[int, int]]:
        """First and last time (ns) of every topic."""
        return {
            number: (int(one.ns.min()), int(one.ns.max())) for number, one in self._streams.items()
        }

    def close(self) -> None:
        """Do nothing: no file stays open between batches."""

    def __enter__(self) -> Self:
        """Return the log."""
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing: no file stays open."""

    def _images(self, number: int, camera: EpisodeCamera) -> Iterator[Batch]:
        """Batches of a camera's images, one message per time."""
        pending: list[tuple[int, bytes]] = []
        size = 0
        missing = 0
        for at, image in camera.read():
            missing += image is None
            pending.append(
                (int(camera.ns[at]), _serialise_image(camera, int(camera.ns[at]), image))
            )
            size += len(pending[-1][1])
            if size >= _BATCH_BYTES:
                yield _batch_of_images(number, pending)
                pending = []
                size = 0
        if pending:
            yield _batch_of_images(number, pending)
        if missing:
            self._count(camera, missing)

    def _count(self, camera: EpisodeCamera, missing: int) -> None:
        self._lost[camera.topic] = (
            f"{camera.topic}: {missing} of {len(camera.ns)} images cannot be read"
        )
        self._refuse(Finding("lost", self._lost[camera.topic]))

    def _refuse(self, finding: Finding) -> None:
        if finding.severity == "lost" and self._strict:
            text = "type the command without --strict to use the rest"
            raise LogError(f"{self.path}: {finding.text}; {text}")


def _describe_episode_topic(number: int, one: EpisodeSignal | Texts | EpisodeCamera) -> Topic:
    kind = _episode_message_type(one)
    text = (
        ros2msg_definition(kind) if kind in (JOINT_STATE, VECTOR) else known_definition(kind) or b""
    )
    return Topic(number, one.topic, kind, "cdr", text, "ros2msg", len(one.ns), one.metadata)


def _episode_message_type(one: EpisodeSignal | Texts | EpisodeCamera) -> str:
    if isinstance(one, EpisodeSignal):
        return one.type
    return TEXT if isinstance(one, Texts) else COMPRESSED if one.size is None else RAW


def _iterate_stored_messages(
    number: int, one: EpisodeSignal | Texts | EpisodeCamera
) -> Iterator[Batch]:
    """All messages of a topic, some megabytes at a time; those of a camera have no image."""
    if isinstance(one, Texts):
        made = _text_batches(one)
        yield Batch(number, one.ns, made.data, made.offset, made.length)
        return
    step = max(1, _BATCH_BYTES // _message_bytes(one))
    for first in range(0, len(one.ns), step):
        ns = one.ns[first : first + step]
        made = cdr.serialise_messages(
            len(ns), _signal_message_fields(one, slice(first, first + step))
        )
        yield Batch(number, ns, made.data, made.offset, made.length)


def _message_bytes(one: EpisodeSignal | EpisodeCamera) -> int:
    """The length of a message of a topic."""
    return int(cdr.serialise_messages(1, _signal_message_fields(one, slice(1))).length[0])


def _signal_message_fields(one: EpisodeSignal | EpisodeCamera, rows: slice) -> list[CdrField]:
    ns = one.ns[rows]
    if isinstance(one, EpisodeCamera):
        return _camera_message_fields(one, ns, np.empty((len(ns), 0), np.uint8))
    values = one.values[rows]
    fields: list[CdrField] = [
        *cdr.cdr_header_field(ns),
        ("string[]", one.names),
        ("float64[]", values),
    ]
    # NaN where ROS would leave the array empty: pybag
    # cannot read a message that ends in an empty array
    unknown = np.broadcast_to(np.nan, values.shape)
    return fields + ([("float64[]", unknown)] * 2 if one.type == JOINT_STATE else [])


def _text_batches(one: Texts) -> Payloads:
    parts = [
        (np.array([k]), cdr.serialise_messages(1, [("string", text)]))
        for k, text in enumerate(one.texts)
    ]
    return cdr.merge_payloads(parts, len(one.texts))


def _camera_message_fields(camera: EpisodeCamera, ns: Array, data: Array) -> list[CdrField]:
    """CompressedImage or Image with the bytes data (n,B); B = 0 for a raw image means no image."""
    if camera.size is None:
        return [*cdr.cdr_header_field(ns), ("string", camera.form), ("uint8[]", data)]
    width, height = camera.size if data.shape[1] else (0, 0)
    return [
        *cdr.cdr_header_field(ns),
        ("uint32", height),
        ("uint32", width),
        ("string", "bgr8"),
        ("uint8", 0),
        ("uint32", 3 * width),
        ("uint8[]", data),
    ]


def _serialise_image(camera: EpisodeCamera, ns: int, image: Array | bytes | None) -> bytes:
    if image is None or isinstance(image, bytes):
        flat = np.frombuffer(image or b"", np.uint8)
    else:
        flat = np.ascontiguousarray(image).reshape(-1)
    return cdr.serialise_messages(
        1, _camera_message_fields(camera, np.array([ns]), flat.reshape(1, -1))
    ).data.tobytes()


def _batch_of_images(number: int, pending: list[tuple[int, bytes]]) -> Batch:
    ns, payloads = zip(*pending, strict=True)
    length = np.array([len(one) for one in payloads], np.int64)
    data = np.frombuffer(b"".join(payloads), np.uint8)
    return Batch(number, np.array(ns, np.int64), data, np.cumsum(length) - length, length)

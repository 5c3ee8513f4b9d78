"""A recording's images as ROS 2 messages: payloads that ROS 2 tools can read are not decoded."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import FormatError, LogError
from ..logs.decode.dynamic import make_dynamic_reader
from ..logs.decode.ros1_to_cdr import known_definition, make_cdr_converter
from ..logs.encode import cdr
from ..logs.encode.cdr import CdrField
from ..logs.formats import open_log, payload_views
from ..logs.images import messages
from ..logs.topics import escape_topic_name
from ..types import Array, LazyImage, Recording, Topic
from .messages import stamps_ns

COMPRESSED = "/camera/image/compressed"
RAW = "/camera/image"
_QUALITY = 95


class Kind(NamedTuple):
    """Topic, type, its definition and the definition's encoding."""

    topic: str
    type: str
    definition: bytes
    form: str

    def below(self, camera: str) -> "Kind":
        """The same under another camera's topics."""
        return self._replace(topic=self.topic.replace("/camera", camera, 1))


EMPTY = ""
"""The key in place of a topic of what is read as images without bytes."""


class ImageMessage(NamedTuple):
    """One image: its kind, its time (s since start_ns), its payload in CDR."""

    kind: Kind
    t: float
    payload: bytes


Frames = Callable[[], Iterator[LazyImage]]
_Convert = Callable[[bytes, int], bytes]
"""A payload and its stamp (ns) -> CDR."""


def image_messages(
    path: Path, recording: Recording, unread: dict[str, list[str]]
) -> Iterator[ImageMessage]:
    """All images that the recording accepts, camera by
    camera, in file order; those of a video are encoded.

    `unread` {topic or video: reasons} gets the images that cannot be read; those that a dataset's
    reader gives without bytes are passed on, and counted under EMPTY. The first camera's topic
    is /camera/image, another's /NAME/image, or as compressed. LogError if two are the same.
    """
    films = {"": recording.cameras.frames} if recording.cameras.frames is not None else {}
    for name, frames in (films | dict(recording.cameras.views)).items():
        under = f"/{escape_topic_name(name)}" if name else "/camera"
        if name and under == "/camera":
            source = recording.facts.roles["camera/camera"]
            raise LogError(
                f"{path}: two cameras would be written as {RAW}; name {source} first in "
                "[topics] camera"
            )
        source = recording.facts.roles.get(f"camera/{name}".strip("/"), "")
        topics = {
            t.id: t
            for t in recording.facts.topics
            if source == t.name or source.startswith(f"{t.name}.")
        }
        if topics:
            found = _pass_through_images(path, recording, frames, topics, unread)
        else:
            found = _encode_video_frames(recording, frames, source, unread)
        yield from (image._replace(kind=image.kind.below(under)) for image in found)


def _pass_through_images(
    path: Path,
    recording: Recording,
    frames: Frames,
    topics: Mapping[int, Topic],
    unread: dict[str, list[str]],
) -> Iterator[ImageMessage]:
    accepted: dict[int, deque[float]] = {}
    for frame in frames():
        accepted.setdefault(frame.source_ns, deque()).append(frame.t)
    carriers = {number: _conversion_of_topic(topic) for number, topic in topics.items()}
    with open_log(path, limits=recording.facts.settings.input) as log:
        for batch in log.batches(list(topics)):
            kind, convert = carriers[batch.topic_id]
            for log_ns, payload in zip(batch.log_ns.tolist(), payload_views(batch), strict=True):
                if times := accepted.get(log_ns):
                    t = times.popleft()
                    try:
                        converted = convert(bytes(payload), _image_stamp_ns(t, recording))
                    except FormatError as problem:
                        unread.setdefault(topics[batch.topic_id].name, []).append(str(problem))
                        continue
                    yield ImageMessage(kind, t, converted)
        for finding in log.findings:  # of images that a dataset's reader could not decode
            if finding.severity == "lost" and finding not in recording.facts.findings:
                unread.setdefault(EMPTY, []).append(finding.text)


def _image_stamp_ns(t: float, recording: Recording) -> int:
    return int(stamps_ns(np.array(t), recording.start_ns))


def _conversion_of_topic(topic: Topic) -> tuple[Kind, _Convert]:
    name = COMPRESSED if topic.type in messages.COMPRESSED else RAW
    if topic.encoding == "ros1":
        convert, definition = make_cdr_converter(topic)
        return Kind(name, topic.type, definition, "ros2msg"), lambda payload, _: bytes(
            convert(memoryview(payload))
        )
    if topic.encoding == "cdr":
        definition = topic.definition
        form = topic.definition_encoding
        if not definition:
            definition = known_definition(topic.type) or b""
            form = "ros2msg"
        return Kind(name, topic.type, definition, form), lambda payload, _: payload
    read = make_dynamic_reader(topic)
    make = _compressed_image_bytes if name == COMPRESSED else _raw_image_bytes
    return _ros2_image_kind(name), lambda payload, stamp: make(read(payload), stamp)


def _ros2_image_kind(name: str) -> Kind:
    kind = "sensor_msgs/msg/CompressedImage" if name == COMPRESSED else "sensor_msgs/msg/Image"
    return Kind(name, kind, known_definition(kind) or b"", "ros2msg")


def _encode_video_frames(
    recording: Recording, frames: Frames, video: str, unread: dict[str, list[str]]
) -> Iterator[ImageMessage]:
    import cv2

    kind = _ros2_image_kind(COMPRESSED)
    for frame in frames():
        try:
            image = frame.image
        except FormatError as problem:
            unread.setdefault(video, []).append(str(problem))
            continue
        done, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        if not done:
            raise FormatError(
                f"{recording.facts.name}: the image at {frame.t:.3f} s cannot be written as JPEG"
            )
        message = {"format": "jpeg", "data": jpeg.tobytes()}
        yield ImageMessage(
            kind, frame.t, _compressed_image_bytes(message, _image_stamp_ns(frame.t, recording))
        )


def _compressed_image_bytes(message: Mapping[str, Any], stamp: int) -> bytes:
    fields: list[CdrField] = [
        *_header_fields(message, stamp),
        ("string", str(message.get("format", ""))),
        _bytes_field(message),
    ]
    return cdr.serialise_messages(1, fields).data.tobytes()


def _raw_image_bytes(message: Mapping[str, Any], stamp: int) -> bytes:
    fields: list[CdrField] = [
        *_header_fields(message, stamp),
        ("uint32", messages.image_size_field(message, "height")),
        ("uint32", messages.image_size_field(message, "width")),
        ("string", str(message.get("encoding", ""))),
        ("uint8", 0),
        ("uint32", messages.image_size_field(message, "step")),
        _bytes_field(message),
    ]
    return cdr.serialise_messages(1, fields).data.tobytes()


def _header_fields(message: Mapping[str, Any], stamp: int) -> list[CdrField]:
    return cdr.cdr_header_field(np.array([stamp]), str(message.get("frame_id", "")))


def _bytes_field(message: Mapping[str, Any]) -> CdrField:
    row: Array = np.frombuffer(messages.image_bytes(message), np.uint8)
    return "uint8[]", row[None]

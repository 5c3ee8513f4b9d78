"""Decode image payloads to BGR: ROS and Foxglove images,
raw or compressed; sizes are checked before decoding.
"""

import re
from base64 import b64decode
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ...errors import FormatError
from ..decode.columns import definition_of, is_ros1, is_ros1_payload
from ..decode.cursor import Payload
from ..decode.dynamic import make_dynamic_reader
from ..decode.layout import Picker
from ..limits import LIMITS
from ..records import Array, Topic
from .codecs import check_size, decode_image

COMPRESSED = (
    "sensor_msgs/msg/CompressedImage",
    "foxglove_msgs/msg/CompressedImage",
    "foxglove.CompressedImage",
)
RAW = ("sensor_msgs/msg/Image", "foxglove_msgs/msg/RawImage", "foxglove.RawImage")
_FFMPEG = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
_VIDEO = ("foxglove_msgs/msg/CompressedVideo", "foxglove.CompressedVideo", _FFMPEG)
_CODECS = re.compile(r"h\.?26[45]|hevc|avc1?|av1|vp[89]|mpeg-?[24]?", re.IGNORECASE)
PACKETS = (
    "a video's packets, not images; replay it through image_transport republish as "
    "CompressedImage, or save the video"
    ' beside the log: [topics] camera = "file.mp4"'
)
_RAW_FIELDS = ("height", "width", "encoding", "step", "data")
_FIELDS = {
    **dict.fromkeys(COMPRESSED, ("format", "data")),
    "sensor_msgs/msg/Image": (*_RAW_FIELDS, "is_bigendian"),
}


FIELDS = frozenset(_RAW_FIELDS)
"""Fields that an image message of an unknown type needs at least."""


class _Encoding(NamedTuple):
    """Channels and bytes per channel of a pixel, which channels
    are BGR; or the OpenCV conversion of the whole image.

    `below`: chroma of 2 by 2 pixels follows in half as many further lines.
    """

    channels: int
    size: int
    bgr: slice = slice(None)
    code: str | None = None
    below: bool = False


_RGB = slice(None, None, -1)
_BGRA = slice(3)
_RGBA = slice(2, None, -1)
ENCODINGS: Mapping[str, _Encoding] = {
    "bgr8": _Encoding(3, 1),
    "8UC3": _Encoding(3, 1),
    "bgr16": _Encoding(3, 2),
    "rgb8": _Encoding(3, 1, _RGB),
    "rgb16": _Encoding(3, 2, _RGB),
    "bgra8": _Encoding(4, 1, _BGRA),
    "8UC4": _Encoding(4, 1, _BGRA),
    "bgra16": _Encoding(4, 2, _BGRA),
    "rgba8": _Encoding(4, 1, _RGBA),
    "rgba16": _Encoding(4, 2, _RGBA),
    "mono8": _Encoding(1, 1),
    "8UC1": _Encoding(1, 1),
    "mono16": _Encoding(1, 2),
    "16UC1": _Encoding(1, 2),
    **{
        f"bayer_{pattern}{8 * size}": _Encoding(1, size, code=f"COLOR_Bayer{pattern.upper()}2BGR")
        for pattern in ("rggb", "bggr", "gbrg", "grbg")
        for size in (1, 2)
    },
    **dict.fromkeys(("yuv422", "uyvy"), _Encoding(2, 1, code="COLOR_YUV2BGR_UYVY")),
    **dict.fromkeys(("yuv422_yuy2", "yuyv", "yuy2"), _Encoding(2, 1, code="COLOR_YUV2BGR_YUY2")),
    **{
        name: _Encoding(1, 1, code=f"COLOR_YUV2BGR_{name.upper()}", below=True)
        for name in ("nv12", "nv21", "i420")
    },
}


def explain_refused_image(topic: Topic, text: str) -> str | None:
    """Why images with this format or encoding text cannot be read, or None."""
    if topic.type in COMPRESSED and _CODECS.fullmatch(text.strip()):
        return f"format {text!r} is {PACKETS}"
    if topic.type in COMPRESSED:
        return (
            "compressedDepth holds depth, not an image"
            if "compresseddepth" in text.lower()
            else None
        )
    return None if text in ENCODINGS else f"encoding {text!r}; possible: {', '.join(ENCODINGS)}"


def is_packets(topic: Topic) -> bool:
    """Whether a topic holds a video's packets, by its type."""
    return topic.type in _VIDEO


def text_field(topic: Topic) -> str:
    """The field that names the format or encoding of a topic's images."""
    return "format" if topic.type in COMPRESSED else "encoding"


def make_image_decoder(
    topic: Topic, mpx: float = LIMITS.max_image_mpx
) -> Callable[[Payload, int], Array]:
    """decode(payload, k) -> (H/k, W/k, 3) uint8 BGR of
    a topic's messages; FormatError names the problem.

    Images of more than `mpx` million pixels are rejected. Raw images are not copied: the result is
    a read-only view of the payload in another order.
    """
    read = _make_field_reader(topic, _FIELDS.get(topic.type, _RAW_FIELDS))
    unpack = _decode_compressed_image if topic.type in COMPRESSED else _decode_raw_image

    def decode(payload: Payload, k: int) -> Array:
        try:
            return unpack(read(payload), k, mpx)
        except (FormatError, TypeError, ValueError) as error:
            # JSON may hold anything under any name, and OpenCV does not convert every size.
            raise FormatError(
                f"{topic.name}: {str(error).removeprefix(f'{topic.name}: ')}"
            ) from None

    return decode


def _make_field_reader(
    topic: Topic, fields: tuple[str, ...]
) -> Callable[[Payload], Mapping[str, Any]]:
    if topic.encoding in ("json", "protobuf"):
        read = make_dynamic_reader(topic)
        return lambda payload: _with_bytes(read(bytes(payload)))
    definition = definition_of(topic)
    paths = tuple((name,) for name in fields)
    pickers = {ros1: Picker(definition, paths, ros1) for ros1 in (False, True)}
    dialect: bool | None = True if is_ros1(topic) else None

    def from_layout(payload: Payload) -> Mapping[str, Any]:
        nonlocal dialect
        ros1 = is_ros1_payload(definition, payload) if dialect is None else dialect
        found = dict(zip(fields, pickers[ros1](payload), strict=True))
        # Only a sound payload determines the dialect of later ones.
        dialect = ros1
        return found

    return from_layout


def _with_bytes(message: Mapping[str, Any]) -> Mapping[str, Any]:
    return {**message, "data": image_bytes(message)}


def image_bytes(message: Mapping[str, Any]) -> bytes:
    """The bytes of an image message, in JSON as base64; FormatError for anything else."""
    data = message.get("data", b"")
    try:
        data = b64decode(data, validate=True) if isinstance(data, str) else data
    except ValueError as error:
        raise FormatError(f"data is not base64: {error}") from None
    if not isinstance(data, bytes):
        raise FormatError(f"data is {str(data)[:20]!r}; possible: bytes, in JSON as base64")
    return data


def _decode_compressed_image(message: Mapping[str, Any], k: int, mpx: float) -> Array:
    form = str(message.get("format", ""))
    if "compresseddepth" in form.lower():
        raise FormatError(f"format {form!r} is compressedDepth, which holds depth, not an image")
    return decode_image(memoryview(message.get("data", b"")), form, k, mpx)


def image_size_field(message: Mapping[str, Any], name: str) -> int:
    """A size in an image message, 0 without that field; FormatError if it is no 32-bit number."""
    value = message.get(name, 0)
    if not isinstance(value, int | float) or isinstance(value, bool) or not 0 <= value < 1 << 32:
        raise FormatError(f"{name} is {str(value)[:20]}; possible: 0 to {(1 << 32) - 1}")
    return int(value)


def _decode_raw_image(message: Mapping[str, Any], k: int, mpx: float) -> Array:
    height = image_size_field(message, "height")
    width = image_size_field(message, "width")
    name = str(message.get("encoding", ""))
    if name not in ENCODINGS:
        raise FormatError(f"encoding {name!r}; possible: {', '.join(ENCODINGS)}")
    encoding = ENCODINGS[name]
    check_size(height, width, mpx)
    data = message.get("data", b"")
    line = width * encoding.channels * encoding.size
    step = image_size_field(message, "step") or line
    lines = height
    if encoding.below:  # publishers disagree on the step of these, so it is computed from the bytes
        lines = height * 3 // 2
        step = len(data) // lines
    if encoding.below and (height % 2 or width % 2 or (name == "i420" and step != line)):
        raise FormatError(
            f"{width} x {height} {name} with step {step}; both must be even, i420's step the width"
        )
    if step < line or len(data) < (lines - 1) * step + line:
        raise FormatError(
            f"{len(data)} bytes for {width} x {height} {name} with step {step}; {lines} x "
            f"{line} needed"
        )
    rows = np.ndarray((lines, line), np.uint8, data, 0, (step, 1))
    rows.flags.writeable = False
    return _to_bgr(rows, encoding, bool(message.get("is_bigendian", 0)), k)


def _to_bgr(rows: Array, encoding: _Encoding, big: bool, k: int) -> Array:
    import cv2

    pixels = rows.reshape(len(rows), -1, encoding.channels * encoding.size)
    if encoding.size == 2:
        # The high byte alone: every decoder converts 16 to 8 bits so.
        pixels = pixels[:, :, 0 if big else 1 :: 2]
    if encoding.code is not None:
        try:
            pixels = cv2.cvtColor(np.ascontiguousarray(pixels), getattr(cv2, encoding.code))
        except cv2.error:
            size = f"{pixels.shape[1]} x {pixels.shape[0]}"
            raise FormatError(
                f"{size} pixels, too few or too odd to convert ({encoding.code[6:]})"
            ) from None
    found = pixels[::k, ::k, encoding.bgr]
    return found if found.shape[2] == 3 else np.broadcast_to(found, (*found.shape[:2], 3))

"""Payloads of a small robot's messages: joints, images, skin; each field may be hostile."""

import base64
import json
import struct
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import cv2
import numpy as np

from .grammar import STEP, T0, Draw

JOINTS = ("shoulder", "elbow")
WIDTH, HEIGHT = 64, 48


class Cdr:
    """A CDR payload, or (`ros1`) a ROS 1 one, written field by field."""

    def __init__(self, ros1: bool = False) -> None:
        self.data, self.ros1 = bytearray() if ros1 else bytearray(b"\0\1\0\0"), ros1

    def number(self, code: str, value: float) -> None:
        """One number; whole ones as their lowest bits."""
        size = struct.calcsize(code)
        if not self.ros1:
            self.data += bytes(-(len(self.data) - 4) % size)
        if code.isalpha() and code in "BIiQq":
            self.data += (int(value) % (1 << 8 * size)).to_bytes(size, "little")
        else:
            self.data += struct.pack("<" + code, value)

    def text(self, raw: bytes) -> None:
        """A string."""
        end = b"" if self.ros1 else b"\0"
        self.number("I", len(raw) + len(end))
        self.data += raw + end

    def header(self, draw: Draw, t_ns: int) -> None:
        """A std_msgs/Header."""
        if self.ros1:
            self.number("I", 0)
        self.number("I", draw.integer(t_ns // 10**9))
        self.number("I", draw.integer(t_ns % 10**9))
        self.text(draw.raw("base"))


@cache
def angles(number: int) -> tuple[float, float]:
    """The joint readings at a message's number, with noise of 1e-3 rad."""
    t, off = number * STEP / 1e9, np.random.default_rng(number).normal(0.0, 1e-3, 2)
    return 0.6 * np.sin(2.1 * t) + off[0], 0.5 * np.cos(1.3 * t) + off[1]


@cache
def picture(number: int) -> np.ndarray:
    """A green disc on grey at the arm's tip."""
    image = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    a, b = angles(number)
    tip = WIDTH / 2 + 18 * np.sin(a) + 9 * np.sin(a + b), HEIGHT / 2 + 12 * np.cos(a) + 6 * np.cos(a + b) - 12
    cv2.circle(image, (round(tip[0]), round(tip[1])), 4, (0, 220, 0), -1)
    return image


@cache
def packed(number: int, suffix: str) -> bytes:
    """The image as JPEG, PNG or WebP."""
    return cv2.imencode(suffix, picture(number))[1].tobytes()


def joint_state(draw: Draw, number: int, ros1: bool = False) -> bytes:
    """A JointState."""
    out = Cdr(ros1)
    out.header(draw, T0 + number * STEP)
    names = JOINTS if not draw.hostile(0.3) else tuple(draw.text(n) for n in JOINTS * draw.of((0, 1, 2, 60)))
    out.number("I", draw.count(len(names)))
    for name in names:
        out.text(draw.raw(name))
    for values in (angles(number), (0.0, 0.0), ()):
        out.number("I", draw.count(len(values)))
        for value in values:
            out.number("d", draw.number(value))
    return bytes(out.data)


def skin(draw: Draw, number: int, ros1: bool = False) -> bytes:
    """A Float64MultiArray of cells."""
    out = Cdr(ros1)
    out.number("I", draw.count(0))
    out.number("I", draw.integer(0))
    cells = [0.1, 0.9 if number % 40 in (7, 8, 9) else 0.1, 0.2, 0.1]
    out.number("I", draw.count(len(cells)))
    for value in cells:
        out.number("d", draw.number(value))
    return bytes(out.data)


def compressed(draw: Draw, number: int, ros1: bool = False) -> bytes:
    """A CompressedImage."""
    out = Cdr(ros1)
    out.header(draw, T0 + number * STEP)
    suffix = draw.of((".jpg", ".png", ".webp"))
    data = hostile_picture(draw, number, suffix) if draw.hostile() else packed(number, suffix)
    out.text(draw.raw(suffix[1:]))
    out.number("I", draw.count(len(data)))
    out.data += data
    return bytes(out.data)


def raw(draw: Draw, number: int, ros1: bool = False) -> bytes:
    """An Image."""
    out = Cdr(ros1)
    out.header(draw, T0 + number * STEP)
    height, width, encoding, step, data = raw_fields(draw, number)
    out.number("I", height)
    out.number("I", width)
    out.text(encoding.encode("utf-8", "replace"))
    out.number("B", draw.integer(0))
    out.number("I", step)
    out.number("I", draw.count(len(data)))
    out.data += data
    return bytes(out.data)


ENCODINGS = (
    "bgr8",
    "rgb8",
    "rgba16",
    "mono16",
    "bayer_rggb8",
    "bayer_gbrg16",
    "yuv422",
    "uyvy",
    "yuv422_yuy2",
    "nv12",
    "nv21",
    "i420",
    "8UC4",
    "32FC1",
    "mono8",
)


def raw_fields(draw: Draw, number: int) -> tuple[int, int, str, int, bytes]:
    """Height, width, encoding, step and data of a raw image."""
    if not draw.hostile(0.7):
        return HEIGHT, WIDTH, "bgr8", 3 * WIDTH, picture(number).tobytes()
    height, width = (draw.of((0, 1, 2, 3, 5, 7, 47, HEIGHT, 2**16, 2**31, 2**32 - 1)) for _ in range(2))
    size = min(height * width * draw.of((1, 2, 3, 4, 6, 8)), 20_000)
    step = draw.integer(draw.of((0, width, 2 * width, 3 * width)), 0)
    return height, width, draw.text(draw.of(ENCODINGS)), step, draw.random.randbytes(size)


def hostile_picture(draw: Draw, number: int, suffix: str) -> bytes:
    """The bytes of an image with damage, or of an absurd size."""
    data = bytearray(packed(number, suffix))
    kind = draw.random.randint(0, 6)
    if kind == 0:
        return draw.noise(400)
    if kind == 1:
        return bytes(data[: draw.random.randint(0, len(data))])
    if kind == 2:
        for _ in range(draw.random.randint(1, 30)):
            data[draw.random.randrange(min(len(data), draw.of((40, 600))))] = draw.random.randrange(256)
        return bytes(data)
    if kind == 3:
        return large(draw.of((".jpg", ".png")), draw.of((3000, 6000, 11_500)))
    if kind == 4:
        return bytes(data) * 3
    if kind == 5:
        return cv2.imencode(suffix, np.zeros(draw.of(((1, 1), (1, 3), (5, 1), (1, 16000))), np.uint8))[1].tobytes()
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBB", 13, b"IHDR", 2**31, 2**31, 8, 2, 0, 0, 0) + bytes(4)


@cache
def large(suffix: str, side: int) -> bytes:
    """A grey image of `side` x `side` pixels in a few kilobytes."""
    options = [cv2.IMWRITE_JPEG_QUALITY, 10] if suffix == ".jpg" else [cv2.IMWRITE_PNG_COMPRESSION, 9]
    return cv2.imencode(suffix, np.zeros((side, side), np.uint8), options)[1].tobytes()


def json_joints(draw: Draw, number: int, ros1: bool = False) -> bytes:
    """A JointState as JSON."""
    stamp = {"sec": draw.integer(T0 // 10**9), "nanosec": draw.integer(number * STEP)}
    message: dict[str, Any] = {"header": {"stamp": stamp}, "name": list(JOINTS), "position": list(angles(number))}
    return _json(draw, message)


def json_picture(draw: Draw, number: int, ros1: bool = False) -> bytes:
    """A foxglove.RawImage as JSON."""
    height, width, encoding, step, data = raw_fields(draw, number)
    stamp = {"sec": draw.integer(T0 // 10**9), "nsec": draw.integer(number * STEP)}
    message = {"timestamp": stamp, "frame_id": "c", "height": height, "width": width, "encoding": encoding}
    return _json(draw, message | {"step": step, "data": base64.b64encode(data).decode()})


def _json(draw: Draw, message: dict[str, Any]) -> bytes:
    """JSON with values replaced anywhere, and numbers that JSON allows but floats cannot hold."""
    spoilt = _spoilt(draw, message)
    text = json.dumps(spoilt).replace("1e+308", draw.of(("1e999", "1e308", "-1e999", "9" * 401)))
    if draw.hostile(0.2):
        text = text.replace('"position": [', '"position": [' + "[" * 900, 1).replace("]}", "]" * 900 + "]}", 1)
    return text.encode("utf-8", "replace")


def _spoilt(draw: Draw, value: Any) -> Any:
    if draw.hostile(0.3):
        return draw.json()
    if isinstance(value, dict):
        return {k: _spoilt(draw, v) for k, v in value.items() if not draw.hostile(0.2)}
    if isinstance(value, list):
        return [_spoilt(draw, v) for v in value]
    return value


Payload = Callable[[Draw, int, bool], bytes]
KINDS: dict[str, tuple[str, Payload]] = {
    "/joint_states": ("sensor_msgs/msg/JointState", joint_state),
    "/camera/image": ("sensor_msgs/msg/Image", raw),
    "/camera/compressed": ("sensor_msgs/msg/CompressedImage", compressed),
    "/skin": ("std_msgs/msg/Float64MultiArray", skin),
}
"""Topic -> type and payloads in CDR or ROS 1."""
OBJECTS: dict[str, tuple[str, Payload]] = {
    "/json/joint_states": ("sensor_msgs/msg/JointState", json_joints),
    "/json/image": ("foxglove.RawImage", json_picture),
}
"""The same in JSON."""


def spoil(draw: Draw, payload: bytes) -> bytes:
    """A payload truncated, lengthened or with changed bytes."""
    kind, data = draw.random.randint(0, 3), bytearray(payload)
    if kind == 0:
        return bytes(data[: draw.random.randint(0, len(data))])
    if kind == 1:
        return bytes(data) + draw.noise(40)
    for _ in range(draw.random.randint(1, 8) if data else 0):
        data[draw.random.randrange(min(len(data), 64))] = draw.random.randrange(256)
    return bytes(data)


def sequence(draw: Draw, make: Payload, count: int, ros1: bool) -> Sequence[bytes]:
    """`count` payloads; a few of them damaged."""
    made = (make(draw, number, ros1) for number in range(count))
    return [spoil(draw, payload) if draw.hostile(0.1) else payload for payload in made]

"""Small logs for tests, written with the public libraries: rosbags for payloads, mcap for the file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

T0 = 1_700_000_000_000_000_000


@dataclass(frozen=True)
class Stream:
    """One channel: messages are (log time ns, payload)."""

    topic: str
    type: str
    definition: bytes
    messages: Sequence[tuple[int, bytes]]
    encoding: str = "cdr"
    definition_encoding: str = "ros2msg"


def write(
    path: Path, streams: Sequence[Stream], in_order: bool = True, chunk: int = 1 << 14, checked: bool = True
) -> Path:
    """An MCAP of the streams, messages interleaved by log time; compressed and with CRCs if `checked`."""
    with path.open("wb") as out:
        kind = CompressionType.ZSTD if checked else CompressionType.NONE
        writer = Writer(out, chunk_size=chunk, compression=kind, enable_crcs=checked)
        writer.start(profile="ros2", library="test")
        schemas = [writer.register_schema(s.type, s.definition_encoding, s.definition) for s in streams]
        channels = [writer.register_channel(s.topic, s.encoding, i) for s, i in zip(streams, schemas, strict=True)]
        rows = [(t, c, p) for s, c in zip(streams, channels, strict=True) for t, p in s.messages]
        for number, (t, channel, payload) in enumerate(sorted(rows, key=lambda r: r[0]) if in_order else rows):
            writer.add_message(channel, t, payload, t, number)
        writer.finish()
    return path


@cache
def store() -> Any:
    """rosbags' humble types."""
    return get_typestore(Stores.ROS2_HUMBLE)


def cdr(type_: str, **fields: Any) -> bytes:
    """One message, little endian; nested values as mappings, headers as (stamp ns, frame)."""
    return bytes(store().serialize_cdr(_message(type_, fields), type_))


def _message(type_: str, fields: Mapping[str, Any]) -> Any:
    kind = store().types[type_]
    return kind(**{name: _value(value) for name, value in fields.items()})


def _value(value: Any) -> Any:
    return _message(*value) if isinstance(value, tuple) else value


def header(stamp_ns: int, frame: str = "base") -> tuple[str, dict[str, Any]]:
    """A std_msgs/Header for `cdr`."""
    sec, nanosec = divmod(stamp_ns, 10**9)
    stamp = ("builtin_interfaces/msg/Time", {"sec": sec, "nanosec": nanosec})
    return ("std_msgs/msg/Header", {"stamp": stamp, "frame_id": frame})


def define(type_: str) -> bytes:
    """The complete ros2msg text of a standard type."""
    return store().generate_msgdef(type_, ros_version=2)[0].encode()


def register(type_: str, text: str) -> None:
    """Make a custom type known to `cdr`."""
    store().register(get_types_from_msg(text, type_))


def joint_state(stamp_ns: int, names: Sequence[str], position: Sequence[float], velocity: Sequence[float] = ()):
    """A JointState payload."""
    held = {"position": position, "velocity": velocity, "effort": ()}
    arrays = {name: np.array(values, np.float64) for name, values in held.items()}
    return cdr("sensor_msgs/msg/JointState", header=header(stamp_ns), name=list(names), **arrays)


def joints(topic: str, messages: Sequence[tuple[int, bytes]]) -> Stream:
    """A JointState channel."""
    return Stream(topic, "sensor_msgs/msg/JointState", define("sensor_msgs/msg/JointState"), messages)


def compressed(stamp_ns: int, image: np.ndarray, suffix: str = ".png", form: str = "png", frame: str = "c") -> bytes:
    """A CompressedImage payload."""
    data = cv2.imencode(suffix, image)[1]
    return cdr("sensor_msgs/msg/CompressedImage", header=header(stamp_ns, frame), format=form, data=data.ravel())


def camera(topic: str, messages: Sequence[tuple[int, bytes]]) -> Stream:
    """A CompressedImage channel."""
    return Stream(topic, "sensor_msgs/msg/CompressedImage", define("sensor_msgs/msg/CompressedImage"), messages)


def varint(value: int) -> bytes:
    """A protobuf varint."""
    out = b""
    while value > 0x7F:
        out, value = out + bytes([value & 0x7F | 0x80]), value >> 7
    return out + bytes([value])


def wire(number: int, value: Any) -> bytes:
    """One protobuf record: int as varint, 4 bytes in a tuple as fixed32, anything else length-delimited."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    if isinstance(value, tuple):
        return varint(number << 3 | 5) + value[0]
    return varint(number << 3 | 2) + varint(len(value)) + value


def descriptors(package: str, messages: dict[str, list[tuple[str, int, int, str]]]) -> bytes:
    """A FileDescriptorSet: message -> fields (name, number, type, type name); names ending in [] repeat."""
    file = wire(2, package.encode())
    for name, fields in messages.items():
        body = wire(1, name.encode())
        for label, number, kind, of in fields:
            repeated = 3 if label.endswith("[]") else 1
            described = wire(1, label.removesuffix("[]").encode()) + wire(3, number) + wire(4, repeated) + wire(5, kind)
            body += wire(2, described + wire(6, of.encode()))
        file += wire(4, body)
    return wire(1, file)

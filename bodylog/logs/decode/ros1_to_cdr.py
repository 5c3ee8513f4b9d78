"""Convert ROS 1 payloads to CDR, and supply ROS 2 definitions where the log has none."""

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import FormatError
from ..encode.cdr import PRIMITIVES
from ..records import Array, Topic

_HEADER = "std_msgs/msg/Header"
_MD5_OF_NOTHING = "d41d8cd98f00b204e9800998ecf8427e"
_SMALL_CONSTANT = re.compile(r"^[ \t]*[\w/]+[ \t]+\w*[a-z]\w*[ \t]*=.*\n?", re.MULTILINE)
"""A constant with lower-case letters: ROS 1 allows
it, ROS 2 and rosbags do not; it takes no bytes.
"""
ROSBAGS_ERRORS = (
    struct.error,
    ValueError,
    KeyError,
    IndexError,
    AssertionError,
    TypeError,
    AttributeError,
)
"""Exceptions of rosbags, besides its own, for what contradicts its definition."""
_SIZES = {
    **{name: np.dtype(code).itemsize for name, code in PRIMITIVES.items()},
    "byte": 1,
    "char": 1,
    "octet": 1,
}
_LONGEST = 1 << 16
_NAMED = 2
_BASE = 1
_SEQUENCE = 4


@dataclass(frozen=True, eq=False)
class Converter:
    """Converts one topic's ROS 1 payloads to CDR; FormatError when that is impossible."""

    topic: Topic
    store: Any

    def __call__(self, payload: memoryview) -> memoryview:
        """Convert one payload to CDR."""
        from rosbags.serde import SerdeError

        try:
            return self.store.ros1_to_cdr(payload, self.topic.type)  # type: ignore[no-any-return]
        except (SerdeError, *ROSBAGS_ERRORS) as problem:
            raise FormatError(f"topic {self.topic.name}: {problem}") from None

    def convert_same_layout(self, rows: Array) -> tuple[Array, Array]:
        """Which payloads (n,L) uint8 have the first one's layout (n,) bool, and their CDR (m,K)."""
        return convert_same_layout(self.store, self.topic.type, rows, self)


def make_cdr_converter(topic: Topic) -> tuple[Converter, bytes]:
    """The converter of a topic and its ros2msg definition;
    FormatError when the definition is missing or invalid.
    """
    store = _ros2_typestore(topic, _ros1_definition(topic))
    return Converter(topic, store), store.generate_msgdef(topic.type, ros_version=2)[0].encode()


def known_definition(kind: str) -> bytes | None:
    """The ros2msg definition of a type that every ROS 2 has; None for others."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    return (
        store.generate_msgdef(kind, ros_version=2)[0].encode() if kind in store.fielddefs else None
    )


def _ros1_definition(topic: Topic) -> str:
    """The topic's definition; if the bag omits it, that of ROS 1's type of this name and MD5."""
    from rosbags.typesys import Stores, get_typestore

    text = topic.definition.decode("utf-8", "replace")
    md5 = topic.metadata.get("md5sum", "")
    if text.strip() or md5 == _MD5_OF_NOTHING:
        return _SMALL_CONSTANT.sub("", text)
    store = get_typestore(Stores.ROS1_NOETIC)
    if topic.type in store.fielddefs:
        known, known_md5 = store.generate_msgdef(topic.type)
        if not md5.strip("0*") or md5 == known_md5:
            return known
    raise FormatError(f"topic {topic.name}: has no definition of {topic.type}")


def _ros2_typestore(topic: Topic, text: str) -> Any:
    """The topic's types with ROS 2's header, which has no sequence number."""
    from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    try:
        types = get_types_from_msg(text, topic.type)
        types[_HEADER] = get_typestore(Stores.ROS2_HUMBLE).fielddefs[_HEADER]
        store.register(types)
        store.get_msgdef(topic.type)
    except (TypesysError, *ROSBAGS_ERRORS) as problem:
        raise FormatError(
            f"topic {topic.name}: the definition of {topic.type} is invalid ({problem})"
        ) from None
    return store


def convert_same_layout(
    store: Any, kind: str, rows: Array, convert: Callable[[memoryview], memoryview]
) -> tuple[Array, Array]:
    """Which of the rows (n,L) uint8 have the layout
    of the first (n,) bool, and their CDR (m,K) uint8.

    `convert` turns one payload of that type into CDR; rosbags' type store
    gives the positions of lengths and texts. FormatError when the first
    row contradicts its type, or is longer than two bytes can count.
    """
    first = rows[0].tobytes()
    convert(memoryview(first))
    settled = np.zeros(len(first), bool)
    try:
        _mark_message(store, kind, first, 0, settled)
    except KeyError as problem:
        raise FormatError(f"{kind} has a field of type {problem}") from None
    if len(first) > _LONGEST:
        raise FormatError(f"{len(first)} bytes where at most {_LONGEST} are possible")
    same = (rows[:, settled] == rows[0, settled]).all(1)
    place = np.arange(len(first))
    probes = [
        _convert_pattern_message(rows[0], settled, digit, convert)
        for digit in (place & 255, ~place & 255, place >> 8)
    ]
    moved = probes[0] != probes[1]
    out = np.tile(probes[0], (int(same.sum()), 1))
    source = probes[0][moved].astype(np.int64) + 256 * probes[2][moved].astype(np.int64)
    out[:, moved] = rows[same][:, source]
    return same, out


def _convert_pattern_message(
    row: Array, settled: Array, digit: Array, convert: Callable[[memoryview], memoryview]
) -> Array:
    """The CDR of a message in which every byte that may vary holds a digit of its own position."""
    probe = np.where(settled, row, digit.astype(np.uint8))
    return np.frombuffer(convert(memoryview(probe.tobytes())), np.uint8)


def _mark_message(store: Any, kind: str, raw: bytes, at: int, settled: Array) -> int:
    """Mark lengths and texts of the message of type `kind` at byte `at`; returns its end."""
    at += 4 * (kind == _HEADER)
    for _, desc in store.fielddefs[kind][1]:
        at = _mark_field(store, desc, raw, at, settled)
    return at


def _mark_field(store: Any, desc: Any, raw: bytes, at: int, settled: Array) -> int:
    form, rest = desc
    if form == _NAMED:
        return _mark_message(store, rest, raw, at, settled)
    if form == _BASE:
        if rest[0] != "string":
            return at + _SIZES[rest[0]]
        end = at + 4 + int.from_bytes(raw[at : at + 4], "little")
        settled[at:end] = True
        return end
    inner = rest[0]
    count = int(rest[1])
    if form == _SEQUENCE:
        count = int.from_bytes(raw[at : at + 4], "little")
        settled[at : at + 4] = True
        at += 4
    if inner[0] == _BASE and inner[1][0] != "string":
        return at + count * _SIZES[inner[1][0]]
    for _ in range(count):
        at = _mark_field(store, inner, raw, at, settled)
    return at

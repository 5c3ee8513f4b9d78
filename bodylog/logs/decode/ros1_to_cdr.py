"""Convert ROS 1 payloads to CDR, and supply ROS 2 definitions where the log has none."""

import re
import struct
from dataclasses import dataclass
from typing import Any

from ...errors import FormatError
from ..records import Array, Topic
from .bulk_convert import convert_same_layout

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

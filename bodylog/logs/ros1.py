"""ROS 1 payloads as CDR, and definitions a ROS 2 reader understands where the log has none."""

import struct
from collections.abc import Callable
from typing import Any

from ..errors import FormatError
from ..types import Topic

Convert = Callable[[memoryview], memoryview]

_HEADER = "std_msgs/msg/Header"
_TROUBLE = (struct.error, ValueError, KeyError, IndexError, AssertionError, TypeError, AttributeError)


def converter(topic: Topic) -> tuple[Convert, bytes]:
    """What turns the topic's ROS 1 payloads into CDR (FormatError when one cannot be), and its ros2msg definition.

    FormatError when the topic's definition is missing or is not one.
    """
    from rosbags.serde import SerdeError

    if not topic.definition.strip():
        raise FormatError(f"topic {topic.name}: has no definition of {topic.type}")
    store = _store(topic)

    def convert(payload: memoryview) -> memoryview:
        try:
            return store.ros1_to_cdr(payload, topic.type)  # type: ignore[no-any-return]
        except (SerdeError, *_TROUBLE) as problem:
            raise FormatError(f"topic {topic.name}: {problem}") from None

    return convert, store.generate_msgdef(topic.type, ros_version=2)[0].encode()


def known_definition(kind: str) -> bytes:
    """The ros2msg definition of a type every ROS 2 has; empty for another."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    return store.generate_msgdef(kind, ros_version=2)[0].encode() if kind in store.fielddefs else b""


def _store(topic: Topic) -> Any:
    """The topic's types with ROS 2's header, which has no sequence number."""
    from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    try:
        types = get_types_from_msg(topic.definition.decode("utf-8", "replace"), topic.type)
        types[_HEADER] = get_typestore(Stores.ROS2_HUMBLE).fielddefs[_HEADER]
        store.register(types)
        store.get_msgdef(topic.type)
    except (TypesysError, *_TROUBLE) as problem:
        raise FormatError(f"topic {topic.name}: the definition of {topic.type} is not one ({problem})") from None
    return store

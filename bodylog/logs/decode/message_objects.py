"""Decode CDR and ROS 1 payloads to rosbags' message objects, one by one."""

from collections.abc import Callable
from typing import Any

from ...errors import FormatError
from ..records import Topic
from .columns import definition_of, is_ros1, is_ros1_payload
from .definitions import PRIMITIVES, TEXTS, Definition, Field
from .ros1_to_cdr import ROSBAGS_ERRORS

_TIMES = {"time": "builtin_interfaces/msg/Time", "duration": "builtin_interfaces/msg/Duration"}

Decode = Callable[[bytes], Any]


def make_object_decoder(topic: Topic) -> Decode:
    """decode(payload) -> message; FormatError for an unreadable definition or payload."""
    definition = definition_of(topic)
    known: dict[bool, Decode] = {}

    def decode(payload: bytes) -> Any:
        ros1 = is_ros1(topic) or (
            (True in known or not known) and is_ros1_payload(definition, payload)
        )
        if ros1 not in known:
            known[ros1] = (
                _make_ros1_decoder(topic) if ros1 else _make_cdr_decoder(topic, definition)
            )
        return known[ros1](payload)

    return decode


def _make_ros1_decoder(topic: Topic) -> Decode:
    from .ros1_to_cdr import make_cdr_converter

    convert, _ = make_cdr_converter(topic)
    read = _wrap_read_errors(topic, convert.store)
    return lambda payload: read(bytes(convert(memoryview(payload))))


def _make_cdr_decoder(topic: Topic, definition: Definition) -> Decode:
    from rosbags.typesys import Stores, TypesysError, get_typestore

    store = get_typestore(Stores.EMPTY)
    try:
        store.register(_rosbags_types(definition))
    except (TypesysError, *ROSBAGS_ERRORS) as problem:
        raise FormatError(
            f"{topic.name}: the definition of {topic.type} cannot be read: {problem}"
        ) from None
    return _wrap_read_errors(topic, store)


def _rosbags_types(definition: Definition) -> Any:
    """The definition in rosbags' notation, times included."""
    from rosbags.interfaces import Nodetype
    from rosbags.typesys import Stores, get_typestore

    def node(field: Field) -> Any:
        plain = field.type in PRIMITIVES or field.type in TEXTS
        kind = _TIMES.get(field.type, field.type)
        one: Any = (Nodetype.BASE, (kind, 0)) if plain else (Nodetype.NAME, kind)
        if field.size is None:
            return one
        return (
            (Nodetype.SEQUENCE, (one, 0)) if field.size < 0 else (Nodetype.ARRAY, (one, field.size))
        )

    standard = get_typestore(Stores.ROS2_HUMBLE).fielddefs
    times = {name: standard[name] for name in _TIMES.values()}
    return times | {
        name: ([], [(f.name, node(f)) for f in fields]) for name, fields in definition.types.items()
    }


def _wrap_read_errors(topic: Topic, store: Any) -> Decode:
    from rosbags.serde import SerdeError

    def read(payload: bytes) -> Any:
        try:
            return store.deserialize_cdr(payload, topic.type)
        except (SerdeError, *ROSBAGS_ERRORS) as problem:
            raise FormatError(f"{topic.name}: {problem}") from None

    return read

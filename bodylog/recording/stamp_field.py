"""Find the field with the timestamp of a topic's messages."""

from ..errors import BodylogError
from ..io.values import read_json
from ..logs.decode.columns import definition_of
from ..logs.decode.definitions import TIMES, Definition
from ..logs.records import Topic

_ALONE = ("stamp", "timestamp")


def stamp_field(topic: Topic) -> str | None:
    """Message path of the stamp: header.stamp, or a
    time called stamp or timestamp; None without one.
    """
    try:
        if topic.encoding == "json":
            return _in_schema(topic.definition)
        if topic.encoding == "protobuf":
            return _in_descriptors(topic)
        return _in_definition(definition_of(topic))
    except BodylogError:
        return None


def _in_schema(schema: bytes) -> str | None:
    try:
        properties = read_json(schema or b"{}").get("properties", {})
    except (ValueError, AttributeError):  # not JSON, or not a table
        return None
    return next(
        (name for name in _ALONE if name in properties),
        "header.stamp" if "header" in properties else None,
    )


def _in_descriptors(topic: Topic) -> str | None:
    from ..logs.decode.protobuf import field_types

    types = field_types(topic)
    return next(
        (name for name in _ALONE if types.get(name, "").endswith(("Timestamp", "Time"))), None
    )


def _in_definition(definition: Definition) -> str | None:
    for field in definition.types[definition.root]:
        if field.size is not None:
            continue
        if field.type in TIMES and field.name in _ALONE:
            return field.name
        inner = definition.types.get(field.type, ()) if field.name == "header" else ()
        if any(f.name == "stamp" and f.type in TIMES and f.size is None for f in inner):
            return "header.stamp"
    return None

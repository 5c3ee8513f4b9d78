"""Where a topic's messages carry the time they speak of."""

from ..errors import BodylogError
from ..types import Topic
from .columns import definition_of
from .definitions import TIMES, Definition

_ALONE = ("stamp", "timestamp")


def stamp_field(topic: Topic) -> str | None:
    """Message path of the stamp: header.stamp, or a time called stamp or timestamp; None when there is none."""
    if topic.encoding in ("json", "protobuf"):
        return "timestamp" if topic.type.startswith("foxglove") else "header.stamp"
    try:
        return _in_definition(definition_of(topic))
    except BodylogError:
        return None


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

"""One Topic per name, type, encoding and definition; batches by topic; names of our topics."""

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

import numpy as np

from ..io.values import LATEST_NS, encodable_text, is_time, log_times_ns
from .diagnostics import Diagnostics
from .records import Array, Batch, Topic

INDEPENDENT: Mapping[str, str] = {"bodylog.motion": "independent poses"}
"""Metadata of a joint topic whose messages are independent poses."""
PREFIX = "/bodylog/"
"""The prefix of every topic that bodylog writes."""
TRACK = PREFIX + "track/"
TRACK_NAMES = ("u", "v", "std_u", "std_v")
POINT_NAMES = ("x", "y", "z", "std_x", "std_y", "std_z")
"""Columns of a track in images, px, and of a point in space, m."""
TRACKER = "tracker"
"""What measures points in space, where nothing says in which frame they are."""
_ILLEGAL = re.compile(
    r"(?:^|(?<=/))[0-9]|[^A-Za-z0-9_/]|(?:^|(?<=/))/|/(?=/|$)|_(?=x[0-9a-f]+[^A-Za-z0-9])"
)


def has_independent_poses(topics: Collection[Topic]) -> bool:
    """Whether a joint topic holds independent poses."""
    return any(
        topic.metadata.get(key) == value for topic in topics for key, value in INDEPENDENT.items()
    )


class TopicTable:
    """The topics of one log, numbered from 0 in order of appearance."""

    def __init__(self) -> None:
        """Start empty."""
        self._topics: dict[tuple[str, str, str, bytes, str], Topic] = {}

    def add(
        self,
        name: str,
        type_name: str,
        encoding: str,
        definition: bytes,
        definition_encoding: str,
        messages: int,
        metadata: Mapping[str, str],
    ) -> int:
        """The id of the topic with these properties; adds to its number of messages."""
        key = (
            encodable_text(name),
            normalise_message_type(encodable_text(type_name)),
            encodable_text(encoding),
            definition,
            encodable_text(definition_encoding),
        )
        known = self._topics.get(key) or Topic(
            len(self._topics), *key, 0, {k: encodable_text(v) for k, v in metadata.items()}
        )
        self._topics[key] = replace(known, messages=known.messages + messages)
        return known.id

    def all(self) -> tuple[Topic, ...]:
        """Every topic, by id."""
        return tuple(self._topics.values())


def normalise_message_type(type_name: str) -> str:
    """package/Name as package/msg/Name; other names unchanged."""
    package, slash, name = type_name.partition("/")
    return f"{package}/msg/{name}" if slash and "/" not in name else type_name


def log_time_span(found: Collection[int], diagnostics: Diagnostics) -> tuple[int, int]:
    """First and last time of a log (ns), 0 if it has
    none; warns about times outside a clock's range.
    """
    sound = [ns for ns in found if is_time(ns)]
    if len(sound) < len(found):
        odd = next(ns for ns in found if not is_time(ns))
        text = (
            f"log times such as {odd} ns are invalid: those below 0 or beyond {LATEST_NS} ns are "
            "read as 0"
        )
        diagnostics.warn(f"{text}, and their messages are not used")
    return min(sound, default=0), max(sound, default=0)


def split_by_topic_id(
    topic: Array, log_ns: Array, data: Array, offset: Array, length: Array
) -> Iterator[Batch]:
    """One Batch per id in topic (n,), in order of appearance; ids below 0 are left out."""
    if not len(topic):
        return
    if topic[0] == topic[-1] and (topic == topic[0]).all():
        if topic[0] >= 0:
            yield Batch(int(topic[0]), log_times_ns(log_ns), data, offset, length)
        return
    order = np.argsort(topic, kind="stable")
    ids, firsts = np.unique(topic[order], return_index=True)
    bounds = [*firsts.tolist(), len(order)]
    for number, low, high in zip(ids.tolist(), bounds, bounds[1:], strict=False):
        if number >= 0:
            rows = order[low:high]
            yield Batch(number, log_times_ns(log_ns[rows]), data, offset[rows], length[rows])


def escape_topic_name(name: str) -> str:
    """`name`, whose / separate parts, as the end of a topic
    name; characters that ROS forbids become _x<hex>_.
    """
    return _ILLEGAL.sub(lambda m: f"_x{ord(m[0]):x}_", name)


def unescape_topic_name(segment: str) -> str:
    """Undo `escape_topic_name`."""
    return re.sub(r"_x([0-9a-f]+)_", lambda m: chr(int(m[1], 16)), segment)

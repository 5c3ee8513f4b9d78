"""Decode messages to arrays: those of the same layout
all at once, others one by one; failures are counted.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, Protocol

import numpy as np

from ...errors import FormatError
from ..records import Array, Batch, Topic
from .cursor import CDR_KINDS, Payload
from .definitions import Definition, parse_definition
from .gather import Template, gather_rows, make_template, match_template, read_leaf_values
from .layout import MessageLayout, count_unread_bytes, fit_wstring_size, leaf_field, locate_fields
from .message_path import Step
from .message_path import parse_steps as read_steps
from .parts import TopicColumns, join_parts

_MOST_LAYOUTS = 8
_OBJECTS = ("json", "protobuf")


class Source(Protocol):
    """The part of a log's interface that decoding needs."""

    def batches(self, ids: Collection[int]) -> Iterator[Batch]:
        """Undecoded messages in file order."""


def read_topic_columns(log: Source, topic: Topic, fields: Sequence[str]) -> TopicColumns:
    """Fields (message paths without the topic) of one topic; ConfigError for a missing field."""
    return columns_of(log, {topic.id: (topic, fields)})[topic.id]


def columns_of(
    log: Source, wants: Mapping[int, tuple[Topic, Sequence[str]]]
) -> dict[int, TopicColumns]:
    """Columns of several topics in one pass over the log, by topic id."""
    decoders = {id_: choose_column_decoder(topic, fields) for id_, (topic, fields) in wants.items()}
    for batch in log.batches(tuple(wants)) if wants else ():
        decoders[batch.topic_id].feed(batch)
    return {id_: found.columns() for id_, found in decoders.items()}


class Decoder(Protocol):
    """Takes batches of one topic and returns its columns."""

    def feed(self, batch: Batch) -> None:
        """Decode one more batch."""

    def columns(self) -> TopicColumns:
        """The columns of all batches so far."""


def choose_column_decoder(topic: Topic, fields: Sequence[str]) -> Decoder:
    """The decoder for a topic's encoding; FormatError or
    ConfigError when its definition cannot give the fields.
    """
    paths = tuple(read_steps(text) for text in fields)
    if topic.encoding in _OBJECTS:
        from .dynamic import ObjectDecoder

        return ObjectDecoder(topic, tuple(fields), paths)
    definition = definition_of(topic)
    for steps in paths:
        leaf_field(definition, steps)
    return _Decoder(definition, tuple(fields), paths, is_ros1(topic))


def definition_of(topic: Topic) -> Definition:
    """The parsed definition of a CDR or ROS 1 topic; FormatError names the topic."""
    if topic.encoding not in ("cdr", "ros1", ""):
        raise FormatError(
            f"{topic.name}: the messages are {topic.encoding!r}; known are cdr, ros1, json, "
            "protobuf"
        )
    if topic.definition_encoding not in ("ros2msg", "ros1msg", "ros2idl", ""):
        known = "ros2msg, ros1msg, ros2idl, jsonschema, protobuf"
        raise FormatError(
            f"{topic.name}: the definition is {topic.definition_encoding!r}; known are {known}"
        )
    try:
        return parse_definition(
            topic.definition, topic.type, topic.definition_encoding or "ros2msg"
        )
    except FormatError as error:
        raise FormatError(f"{topic.name}: {error}") from None


def is_ros1(topic: Topic) -> bool:
    """Whether the payloads are declared as ROS 1."""
    return topic.encoding == "ros1"


def is_ros1_payload(definition: Definition, payload: Payload) -> bool:
    """Whether a payload declared CDR is ROS 1: not
    readable as CDR, but readable to its end as ROS 1.
    """
    if tuple(payload[:2]) in CDR_KINDS and _left_over(definition, payload, False) is not None:
        return False
    return _left_over(definition, payload, True) == 0


def _left_over(definition: Definition, payload: Payload, ros1: bool) -> int | None:
    try:
        return count_unread_bytes(definition, payload, ros1)
    except FormatError:
        return None


class _Decoder:
    """Decodes CDR and ROS 1 topics to columns."""

    def __init__(
        self,
        definition: Definition,
        fields: tuple[str, ...],
        paths: tuple[tuple[Step, ...], ...],
        ros1: bool,
    ) -> None:
        self.definition = definition
        self.fields = fields
        self.paths = paths
        self.ros1 = ros1
        self.declared = ros1
        self.known: list[Template] = []
        self.log_ns: list[Array] = []
        self.pieces: dict[Any, list[tuple[Array, list[Any]]]] = {}
        self.seen = 0
        self.fast = 0
        self.fallback = 0
        self.rejected: Counter[str] = Counter()

    def feed(self, batch: Batch) -> None:
        """Decode one more batch: known layouts first, then new ones, then message by message."""
        if not self.seen and len(batch.log_ns) and not self.declared:
            self.ros1 = is_ros1_payload(self.definition, _payload_at(batch, 0))
        self.log_ns.append(np.array(batch.log_ns, np.int64))
        left = np.arange(len(batch.log_ns))
        for known in self.known:
            left = self._take(batch, left, known)
        while len(left) and len(self.known) < _MOST_LAYOUTS:
            left = self._learn(batch, left)
        for index in left.tolist():
            self._one(batch, index)
        self.seen += len(batch.log_ns)

    def _learn(self, batch: Batch, left: Array) -> Array:
        payload = _payload_at(batch, int(left[0]))
        layout = self._walk(payload)
        if layout is None:
            return left[1:]
        self.known.append(make_template(layout, payload))
        return self._take(batch, left, self.known[-1])

    def _one(self, batch: Batch, index: int) -> None:
        payload = _payload_at(batch, index)
        layout = self._walk(payload)
        if layout is not None:
            row = np.frombuffer(payload, np.uint8, layout.width)[None]
            self._keep(np.array([index]), row, layout)
            self.fallback += 1

    def _walk(self, payload: bytes) -> MessageLayout | None:
        with suppress(FormatError):
            return locate_fields(self.definition, payload, self.paths, self.ros1)
        for sized in (fits := fit_wstring_size(self.definition, payload, self.ros1)):
            self.definition = sized if len(fits) == 1 else self.definition
            return locate_fields(sized, payload, self.paths, self.ros1)
        self.rejected["malformed"] += 1
        return None

    def _take(self, batch: Batch, left: Array, known: Template) -> Array:
        """Decode the messages of `left` with the layout `known`; returns the others."""
        long = left[batch.length[left] >= known.layout.width]
        rows = gather_rows(batch.data, batch.offset[long], 8 * known.words)
        same = match_template(rows, known)
        if not same.all():
            long = long[same]
            rows = rows[same]
        if len(long):
            self._keep(long, rows, known.layout)
            self.fast += len(long)
        return left[:0] if len(long) == len(left) else np.setdiff1d(left, long, assume_unique=True)

    def _keep(self, index: Array, rows: Array, layout: MessageLayout) -> None:
        found = [read_leaf_values(rows, leaf) for leaf in layout.leaves]
        shape = tuple(v if isinstance(v, tuple) else v.shape[1:] for v in found)
        self.pieces.setdefault(shape, []).append((index + self.seen, found))

    def columns(self) -> TopicColumns:
        """The columns of all batches so far."""
        log_ns = np.concatenate(self.log_ns) if self.log_ns else np.empty(0, np.int64)
        parts = tuple(join_parts(pieces) for pieces in self.pieces.values())
        return TopicColumns(
            self.fields, log_ns, parts, self.fast, self.fallback, dict(self.rejected)
        )


def _payload_at(batch: Batch, index: int) -> bytes:
    start = int(batch.offset[index])
    return batch.data[start : start + int(batch.length[index])].tobytes()

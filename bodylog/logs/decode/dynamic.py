"""Decode JSON and protobuf payloads to columns: protobuf
of equal layout at once, the rest through dictionaries.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ...errors import FormatError
from ...io.values import read_json
from ..records import Array, Batch, Topic
from .message_path import Step
from .object_places import Value, follow_steps, number_of, shape_values
from .parts import ColumnPart, TopicColumns, join_parts
from .protobuf import ProtobufLayout, root_of

_MOST_LAYOUTS = 64
"""Layouts per topic: with more, messages share too little for batch decoding to pay."""
_FEW = 4
"""So few messages decode faster one by one."""
Found = Iterator[tuple[Array, list[Any]]]
"""Indices (m,) of messages in a batch and, by path, their values (m,), (m,K) or texts."""
_UNLIKE = (FormatError, KeyError, ValueError, TypeError, RecursionError)


class JsonBatchDecoder:
    """Decodes only members of JSON objects at which message paths begin, for a batch at once."""

    def __init__(self, paths: Sequence[tuple[Step, ...]], single: Sequence[int | None]) -> None:
        """For message paths; none is read together if one does not begin with a member."""
        import msgspec

        self._paths = paths
        self._single = single
        self._errors = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)
        members = list(
            dict.fromkeys(steps[0] for steps in paths if steps and isinstance(steps[0], str))
        )
        self._attributes = {member: f"member_{k}" for k, member in enumerate(members)}
        fields = [
            (attribute, Any, msgspec.field(name=member))
            for member, attribute in self._attributes.items()
        ]
        self._decode = msgspec.json.Decoder(msgspec.defstruct("Members", fields, gc=False)).decode

    def take(self, batch: Batch) -> Found:
        """Decode the messages that are strict JSON and
        have all members, if their values have one shape.

        What strict JSON lacks (NaN, lone surrogates, UTF-16,
        numbers beyond floats) is left for the standard library.
        """
        if not all(steps and isinstance(steps[0], str) for steps in self._paths):
            return
        index = []
        messages = []
        data = batch.data.data
        ends = batch.offset + batch.length
        for row, (begin, end) in enumerate(zip(batch.offset.tolist(), ends.tolist(), strict=True)):
            try:
                messages.append(self._decode(data[begin:end]))
            except self._errors:
                continue
            index.append(row)
        if not messages:
            return
        values: list[Any] = []
        for steps, single in zip(self._paths, self._single, strict=True):
            attribute = self._attributes[str(steps[0])]
            column = _column_of(
                [getattr(message, attribute) for message in messages], steps[1:], single
            )
            if column is None:
                return
            values.append(column)
        yield np.array(index), values


class ProtobufBatchDecoder:
    """Decodes protobuf messages at once that have the
    same fields in the same order, and equal length.
    """

    def __init__(
        self, topic: Topic, paths: Sequence[tuple[Step, ...]], single: Sequence[int | None]
    ) -> None:
        """Start without a known layout; FormatError when the topic's schema is broken."""
        self._types, self._root = root_of(topic)
        self._paths = paths
        self._single = single
        self._known: dict[int, list[ProtobufLayout]] = {}
        self._count = 0

    def take(self, batch: Batch) -> Found:
        """Decode the messages that share a layout."""
        for length in np.unique(batch.length).tolist():
            index = np.flatnonzero(batch.length == length)
            for layout in self._known.get(length, ()):
                index = yield from self._same_layout(batch, index, layout)
            while len(index) > _FEW and self._count < _MOST_LAYOUTS:
                learned = self._learn(batch, int(index[0]))
                if learned is None:
                    index = index[1:]
                else:
                    index = yield from self._same_layout(batch, index, learned)

    def _same_layout(self, batch: Batch, index: Array, layout: ProtobufLayout) -> Any:
        """Yield the decoded messages of this layout; return the others."""
        if not len(index):
            return index
        same, values = layout.values(batch, index, self._single)
        if values is None or not same.any():
            return index if values is not None else index[~same]
        yield index[same], values
        return index[~same]

    def _learn(self, batch: Batch, index: int) -> ProtobufLayout | None:
        start = int(batch.offset[index])
        payload = batch.data[start : start + int(batch.length[index])].tobytes()
        self._count += 1
        try:
            from .object_places import follow_steps

            layout = ProtobufLayout(payload, self._types, self._root, self._paths, follow_steps)
        except _UNLIKE:
            return None
        self._known.setdefault(layout.width, []).append(layout)
        return layout


def make_dynamic_reader(topic: Topic) -> Callable[[bytes], Mapping[str, Any]]:
    """A function from payload to dictionary; FormatError
    for a broken schema, or later for a broken payload.
    """
    if topic.encoding == "json":
        return lambda payload: _parse_json_payload(topic.name, payload)
    from .protobuf import message_reader

    return message_reader(topic)


def _parse_json_payload(name: str, payload: bytes) -> Mapping[str, Any]:
    try:
        value = read_json(payload)
    except ValueError as error:
        raise FormatError(f"{name}: the payload is not JSON: {str(error)[:60]}") from None
    if not isinstance(value, dict):
        raise FormatError(
            f"{name}: the payload is a JSON {type(value).__name__}; expected an object"
        )
    return value


class ObjectDecoder:
    """Decodes JSON and protobuf topics to columns."""

    def __init__(
        self, topic: Topic, fields: tuple[str, ...], paths: tuple[tuple[Step, ...], ...]
    ) -> None:
        """Start without messages; FormatError when the schema is broken."""
        self.fields = fields
        self.paths = paths
        self.single = [number_of(steps) for steps in paths]
        self.log_ns: list[Array] = []
        self.rows: dict[Any, list[tuple[int, list[tuple[Value, ...]]]]] = {}
        self.pieces: dict[Any, list[tuple[Array, list[Any]]]] = {}
        self.seen = 0
        self.fast = 0
        self.rejected: Counter[str] = Counter()
        self.read = make_dynamic_reader(topic)
        self.together: JsonBatchDecoder | ProtobufBatchDecoder = (
            JsonBatchDecoder(paths, self.single)
            if topic.encoding == "json"
            else ProtobufBatchDecoder(topic, paths, self.single)
        )

    def feed(self, batch: Batch) -> None:
        """Decode one more batch: messages of equal layout at once, then the rest."""
        self.log_ns.append(np.array(batch.log_ns, np.int64))
        left = np.ones(len(batch.log_ns), bool)
        for index, values in self.together.take(batch):
            shape = tuple(v if isinstance(v, tuple) else v.shape[1:] for v in values)
            self.pieces.setdefault(shape, []).append((self.seen + index, values))
            left[index] = False
            self.fast += len(index)
        for row in np.flatnonzero(left).tolist():
            start = int(batch.offset[row])
            self._one(self.seen + row, batch.data[start : start + int(batch.length[row])].tobytes())
        self.seen += len(left)

    def _one(self, row: int, payload: bytes) -> None:
        try:
            message = self.read(payload)
            values = [tuple(follow_steps(message, steps)) for steps in self.paths]
        except (FormatError, RecursionError):
            self.rejected["malformed"] += 1
        except (KeyError, ValueError, TypeError):
            self.rejected["field missing"] += 1
        else:
            shape = tuple(
                v if any(isinstance(x, str | bytes) for x in v) else len(v) for v in values
            )
            self.rows.setdefault(shape, []).append((row, values))

    def columns(self) -> TopicColumns:
        """The columns of all batches so far."""
        log_ns = np.concatenate(self.log_ns) if self.log_ns else np.empty(0, np.int64)
        parts = tuple(self._part(shape, rows) for shape, rows in self.rows.items())
        slow = sum(len(part.rows) for part in parts)
        parts += tuple(join_parts(pieces) for pieces in self.pieces.values())
        return TopicColumns(self.fields, log_ns, parts, self.fast, slow, dict(self.rejected))

    def _part(self, shape: Any, rows: list[tuple[int, list[tuple[Value, ...]]]]) -> ColumnPart:
        values: list[Array | tuple[str, ...]] = []
        for k, key in enumerate(shape):
            if isinstance(key, tuple):
                values.append(tuple(str(x) for x in key))
                continue
            array = np.array([v[k] for _, v in rows]).reshape(len(rows), key)
            values.append(shape_values(array, self.single[k]))
        return ColumnPart(np.array([row for row, _ in rows]), tuple(values))


def _column_of(
    values: list[Any], steps: Sequence[Step], single: int | None
) -> Array | tuple[str, ...] | None:
    """The numbers (n,) or (n,K) or equal texts at the end
    of the steps; None where values must be read one by one.
    """
    from .object_places import follow_steps

    try:
        for step in steps:
            if not isinstance(step, str):
                values = [list(follow_steps(value, (step,))) for value in values]
            else:
                values = [value[step] for value in values]
        if isinstance(values[0], dict):
            values = [next(follow_steps(value, ()), None) for value in values]
    except _UNLIKE:
        return None
    texts = values[0] if isinstance(values[0], list) else [values[0]]
    if texts and all(type(text) is str and text.isascii() for text in texts):
        return tuple(texts) if values.count(values[0]) == len(values) else None
    try:
        found = np.array(values)
    except ValueError:  # arrays of several lengths
        return None
    if found.dtype not in (np.float64, np.int64) or found.ndim > 2:
        return None
    return shape_values(found.reshape(len(found), -1), single)

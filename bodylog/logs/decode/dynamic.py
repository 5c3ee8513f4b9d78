"""Decode JSON and protobuf payloads to columns: protobuf
of equal layout at once, the rest through dictionaries.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ...errors import FormatError
from ...io.values import read_json
from ..records import Array, Batch, Topic
from .message_path import Step
from .object_places import number_of, shape_values
from .object_values import Value, follow_steps
from .parts import ColumnPart, TopicColumns, join_parts


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
        from .batch_decoders import JsonBatchDecoder, ProtobufBatchDecoder

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

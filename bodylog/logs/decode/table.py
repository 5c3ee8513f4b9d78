"""One topic's messages as arrays; each field is decoded on first use."""

import difflib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...io.extras import require_module
from ..records import Array, Topic
from .columns import definition_of
from .definitions import PRIMITIVES, TEXTS, TIMES, Definition
from .layout import leaf_field
from .message_path import is_index, parse_steps
from .parts import TopicColumns

Read = Callable[[Mapping[str, Sequence[str]]], Mapping[str, "Table"]]
"""Reads fields of topics in one pass."""

_OBJECTS = ("json", "protobuf")
TIME_KEYS = frozenset(("sec", "secs", "seconds"))
"""A JSON or protobuf object with one of these is a time."""


@dataclass(frozen=True, eq=False)
class _Field:
    """One decoded field: rows (m,) of the topic's messages
    in which it decodes, its values (m,) or (m,K), ascending.
    """

    rows: Array
    values: Array


class Table:
    """The messages of one topic in order of log time:
    `table.position`, `table["header.stamp"]`, `table.log_ns`.

    A row is a message in which every requested field decodes; `rejected` counts the others by
    reason. Numbers are arrays (N,), arrays of numbers (N,K) padded with NaN, bytes of several
    lengths objects (N,), times int64 ns, texts (N,) of str. ConfigError names the existing fields.
    """

    def __init__(
        self, name: str, fields: tuple[str, ...], read: Read, log_ns: Array | None = None
    ) -> None:
        """The topic's name, its leaf fields, how to read them,
        and log_ns (n,) of all its messages in file order.
        """
        self._name = name
        self.fields = fields
        self.rejected: dict[str, int] = {}
        self._read = read
        self._log_ns = log_ns
        self._found: dict[str, _Field] = {}

    def __len__(self) -> int:
        """The number of rows."""
        return len(self._rows)

    def __getitem__(self, field: str) -> Array:
        """One field by its message path, e.g. "header.stamp",
        "transforms[:].transform.translation.x".
        """
        if field not in self._found:
            self._take([field])
        found = self._found[field]
        return found.values[np.searchsorted(found.rows, self._rows)]

    def __getattr__(self, name: str) -> Any:
        """A field, or the fields of an inner message: `table.header.stamp`."""
        if name.startswith("_"):
            raise AttributeError(name)
        return _fields_below(self, name)

    def __dir__(self) -> Iterator[str]:
        """Attributes, including the fields, for name completion."""
        yield from super().__dir__()
        yield from {field.split(".")[0].split("[")[0] for field in self.fields}

    def __repr__(self) -> str:
        """Name, number of messages and fields."""
        return f"<Table {self._name}: {', '.join(self.fields)}>"

    @property
    def log_ns(self) -> Array:
        """Log time (N,) int64 ns of each row."""
        return self._times[self._rows]

    def to_pandas(self, fields: Sequence[str] | None = None) -> Any:
        """A pandas DataFrame: log_ns, then each field, arrays
        as one column per element. Needs the extra pandas.
        """
        return require_module("pandas").DataFrame(dict(self._flat(fields)))

    def to_arrow(self, fields: Sequence[str] | None = None) -> Any:
        """A pyarrow Table: log_ns, then each field, arrays as one column per element."""
        pa = require_module("pyarrow")
        return pa.table({name: pa.array(values) for name, values in self._flat(fields)})

    def _flat(self, fields: Sequence[str] | None) -> Iterator[tuple[str, Array]]:
        wanted = self.fields if fields is None else tuple(fields)
        if missing := [field for field in wanted if field not in self._found]:
            self._take(missing)
        yield "log_ns", self.log_ns
        for field in wanted:
            values = self[field]
            if values.ndim == 1:
                yield field, values
            else:
                yield from ((f"{field}[{k}]", values[:, k]) for k in range(values.shape[1]))

    @property
    def _times(self) -> Array:
        """Log times (n,) of all messages in file order."""
        if self._log_ns is None:
            self._take([])
        assert self._log_ns is not None
        return self._log_ns

    @property
    def _rows(self) -> Array:
        """The rows in order of log time."""
        sound = np.ones(len(self._times), bool)
        for found in self._found.values():
            if len(found.rows) < len(sound):
                sound &= np.isin(np.arange(len(sound)), found.rows, assume_unique=True)
        order = np.argsort(self._times, kind="stable")
        return order[sound[order]]

    def _take(self, fields: Sequence[str]) -> None:
        other = self._read({self._name: fields})[self._name]
        self._log_ns = other._times
        self._found |= other._found
        for reason, count in other.rejected.items():
            self.rejected[reason] = max(count, self.rejected.get(reason, 0))


class Struct:
    """The fields of an inner message."""

    def __init__(self, table: Table, path: str) -> None:
        """The fields of `table` that begin with `path`."""
        self._table = table
        self._path = path

    def __getattr__(self, name: str) -> Any:
        """A field, or the fields below it."""
        if name.startswith("_"):
            raise AttributeError(name)
        return _fields_below(self._table, f"{self._path}.{name}")

    def __repr__(self) -> str:
        """The fields."""
        below = (field for field in self._table.fields if field.startswith(self._path))
        return f"<{self._table._name}.{self._path}: {', '.join(below)}>"


def _fields_below(table: Table, path: str) -> Any:
    if path in table.fields:
        return table[path]
    inner = next((f for f in table.fields if f.startswith((f"{path}.", f"{path}["))), None)
    if inner is not None:
        return Struct(table, inner[: len(path) + 3] if inner[len(path)] == "[" else path)
    near = difflib.get_close_matches(path, table.fields, 1, 0.0)
    hint = f"; did you mean {near[0]}?" if near else ""
    raise AttributeError(
        f"{table._name}: no field {path!r}{hint} The fields are {', '.join(table.fields)}"
    )


def fill_table(
    table: Table, topics: Sequence[Topic], columns: Sequence[TopicColumns], wanted: Sequence[str]
) -> Table:
    """The table with the fields `wanted`, from the columns of each of the topic's schemas."""
    starts = np.cumsum([0, *(len(c.log_ns) for c in columns)])
    for field in wanted:
        rows = np.concatenate([c.sound + start for c, start in zip(columns, starts, strict=False)])
        parts = [
            _topic_column(t, c, field) for t, c in zip(topics, columns, strict=True) if len(c.sound)
        ]
        table._found[field] = _Field(rows, _concatenate_columns(parts))
    for one in columns:
        for reason, count in one.rejected.items():
            table.rejected[reason] = table.rejected.get(reason, 0) + count
    return table


def _topic_column(topic: Topic, columns: TopicColumns, field: str) -> Array:
    packed = [part.values[columns.fields.index(field)] for part in columns.parts]
    if (
        len(
            {
                part.shape[1:]
                for part in packed
                if isinstance(part, np.ndarray) and part.dtype == np.uint8
            }
        )
        > 1
    ):
        return _byte_objects(columns, packed)
    values = columns.column(field)
    single = (
        values.dtype.kind == "U"
        and values.ndim == 2
        and values.shape[1] == 1
        and _is_single(topic, field)
    )
    return values[:, 0] if single else values


def _byte_objects(columns: TopicColumns, packed: Sequence[Any]) -> Array:
    """Arrays of bytes of several lengths, as objects:
    padded, images would take a multiple of the log's size.
    """
    found = [
        (row, one.tobytes())
        for part, values in zip(columns.parts, packed, strict=True)
        for row, one in zip(part.rows.tolist(), values, strict=True)
    ]
    out = np.empty(len(found), object)
    out[:] = [one for _, one in sorted(found)]
    return out


def _is_single(topic: Topic, field: str) -> bool:
    path = parse_steps(field)
    if topic.encoding in _OBJECTS:
        return all(isinstance(step, str) or is_index(step) for step in path)
    return leaf_field(definition_of(topic), path)[1]


def _concatenate_columns(parts: Sequence[Array]) -> Array:
    if len(parts) == 1:
        return parts[0]
    widths = {part.shape[1:] for part in parts}
    if len(widths) > 1:
        widest = max(part.shape[1] if part.ndim == 2 else 1 for part in parts)
        parts = [_pad_rows(part if part.ndim == 2 else part[:, None], widest) for part in parts]
    return np.concatenate(parts) if parts else np.empty(0)


def _pad_rows(values: Array, width: int) -> Array:
    if values.shape[1] == width:
        return values
    empty: Any = "" if values.dtype.kind == "U" else np.nan
    return np.concatenate([values, np.full((len(values), width - values.shape[1]), empty)], axis=1)


def leaf_paths(definition: Definition) -> Iterator[str]:
    """The leaf fields of a CDR or ROS 1 message by message path."""
    yield from _leaf_paths(definition, definition.root)


def _leaf_paths(definition: Definition, type_: str, prefix: str = "") -> Iterator[str]:
    for field in definition.types[type_]:
        path = prefix + field.name
        if field.type in PRIMITIVES or field.type in TEXTS or field.type in TIMES:
            yield path
        else:
            yield from _leaf_paths(
                definition, field.type, f"{path}." if field.size is None else f"{path}[:]."
            )


def object_paths(message: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """The leaf fields of a JSON or protobuf message by message path."""
    for name, value in message.items():
        path = prefix + name
        first = value[0] if isinstance(value, list) and value else value
        if isinstance(first, dict) and not TIME_KEYS & first.keys():
            yield from object_paths(first, f"{path}[:]." if isinstance(value, list) else f"{path}.")
        else:
            yield path

"""Write arrays as an MCAP: columns of fields in, chunks of CDR messages out."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from ..errors import ConfigError, FormatError, UsageError
from ..io.atomic_files import replace_atomically
from .conversion.transcode import LIBRARY, PROFILE
from .decode.definitions import PRIMITIVES, TEXTS, TIMES, Definition, Field, parse_definition
from .decode.ros1_to_cdr import known_definition
from .encode import cdr
from .encode.cdr import Payloads
from .mcap.encode import MessageTable, gather_pieces
from .mcap.writer import Contents
from .mcap.writer import McapRecordWriter as Chunks
from .records import Array, Batch, Topic

_CDR_NAMES = {"byte": "uint8", "char": "uint8", "octet": "uint8"}


class Writer:
    """Writes an MCAP, ROS 2 profile; a context manager. An exception leaves no file.

    `write` takes all or part of a topic's messages as arrays.
    """

    def __init__(self, path: str | Path) -> None:
        """The output file; it appears when the `with` block ends."""
        self._path = Path(path)
        self._open = ExitStack()
        self._chunks: Chunks | None = None
        self._channels: dict[tuple[str, str, bytes], int] = {}
        self._counts: dict[int, int] = {}

    def __enter__(self) -> Self:
        """Open a temporary file beside the output."""
        with ExitStack() as opening:
            stream = opening.enter_context(
                opening.enter_context(replace_atomically(self._path)).open("wb")
            )
            self._chunks = Chunks(stream, Contents())
            self._chunks.begin(PROFILE, LIBRARY)
            self._open = opening.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> bool | None:
        """Write the summary and move the file into place; after an exception, remove it."""
        if kind is None and self._chunks is not None:
            self._chunks.finish()
        self._chunks = None
        return self._open.__exit__(kind, problem, trace)

    def write(
        self,
        topic: str,
        type: str,
        log_ns: Array,
        fields: Mapping[str, Any],
        definition: str | None = None,
    ) -> None:
        """Write messages of one topic from their fields;
        ConfigError for a field or type that does not fit.

        log_ns (n,) int64 · fields {message path: values}: a number or text for all messages, an
        array (n,), for array fields (n,K) or a list of n arrays or bytes; times int64 ns; missing
        fields are 0 or empty. definition: the type's ros2msg text, needed for types outside ROS 2.
        """
        times = np.asarray(log_ns, np.int64).reshape(-1)
        text = self._definition(type, definition)
        parsed = parse_definition(text, type, "ros2msg")
        known = dict(_writable_paths(parsed, parsed.root))
        if unknown := [name for name in fields if name not in known]:
            raise ConfigError(
                f"{topic}: {type} has no field {unknown[0]!r}; the fields are "
                f"{', '.join(sorted(known))}"
            )
        values = {
            name: _convert_field_values(topic, name, known[name], value, len(times))
            for name, value in fields.items()
        }
        key = topic, type, text
        if key not in self._channels:
            self._channels[key] = self._writing().topic(topic, type, "cdr", text, "ros2msg", {})
        self._put(key, times, _serialise_layout_groups(parsed, values, len(times)))

    def write_batch(self, topic: Topic, batch: Batch) -> None:
        """Write undecoded messages of another log unchanged:
        one of its topics, and a batch of that topic.
        """
        key = topic.name, topic.type, topic.definition
        if key not in self._channels:
            about = (topic.encoding, topic.definition, topic.definition_encoding, topic.metadata)
            self._channels[key] = self._writing().topic(topic.name, topic.type, *about)
        data, offset = gather_pieces(batch.data, batch.offset, batch.length)
        self._put(key, batch.log_ns, Payloads(data, offset, batch.length))

    def _definition(self, type_: str, given: str | None) -> bytes:
        found = known_definition(type_) if given is None else given.encode()
        if found is None:
            raise ConfigError(f"{type_}: not a standard type; give its definition as ros2msg text")
        return found

    def _put(self, key: tuple[str, str, bytes], log_ns: Array, payloads: Payloads) -> None:
        if len(log_ns) and log_ns.min() < 0:
            raise ConfigError(f"{key[0]}: log time {log_ns.min()} ns; none is before 0")
        channel = self._channels[key]
        before = self._counts.get(channel, 0)
        self._counts[channel] = before + len(log_ns)
        if len(log_ns):
            ids = np.full(len(log_ns), channel)
            sequence = before + np.arange(len(log_ns))
            data = (payloads.data,)
            self._writing().write(
                MessageTable(ids, sequence, log_ns, log_ns, data, payloads.offset, payloads.length)
            )

    def _writing(self) -> Chunks:
        if self._chunks is None:
            raise UsageError(f"{self._path}: write inside a with: `with logs.Writer(path) as out:`")
        return self._chunks


def _writable_paths(
    definition: Definition, type_: str, prefix: str = ""
) -> Iterator[tuple[str, Field]]:
    """The writable fields by message path; arrays of messages are not writable and stay empty."""
    for field in definition.types[type_]:
        if field.type in PRIMITIVES or field.type in TEXTS or field.type in TIMES:
            yield prefix + field.name, field
        elif field.size is None:
            yield from _writable_paths(definition, field.type, f"{prefix}{field.name}.")


@dataclass(frozen=True, eq=False)
class _Texts:
    """Distinct texts, or tuples of texts, and the index of each message's text (n,)."""

    known: Sequence[Any]
    index: Array


def _convert_field_values(topic: str, name: str, field: Field, value: Any, count: int) -> Any:
    """One field of `count` messages: _Texts · numbers or ns
    (n,) · for arrays (n,K), or a list of n arrays or bytes.
    """
    if isinstance(value, np.ndarray) and value.dtype == object:
        value = list(value)  # messages of unequal length, as a Table has them
    constant = _is_constant(field, value)
    if not constant and len(value) != count:
        raise ConfigError(f"{topic}: {name} has {len(value)} values for {count} messages")
    if field.type in TEXTS:
        return _encode_texts(field, [value] if constant else value, count)
    if field.size is not None and field.type in TIMES:
        raise ConfigError(f"{topic}: {name} is an array of times, which cannot be written")
    if not constant and field.size is not None and len({len(one) for one in value}) > 1:
        return value
    numbers = (
        np.frombuffer(value, np.uint8)
        if isinstance(value, bytes)
        else np.asarray(_bytes_to_arrays(value))
    )
    numbers = np.broadcast_to(numbers, (count, *numbers.shape)) if constant else numbers
    wanted = 1 if field.size is None else 2
    if numbers.ndim != wanted or (
        wanted == 2 and field.size != -1 and numbers.shape[1] != field.size
    ):
        shape = "(n,)" if wanted == 1 else f"(n, {'K' if field.size == -1 else field.size})"
        raise ConfigError(f"{topic}: {name} has shape {numbers.shape}; {shape} is expected")
    return numbers


def _is_constant(field: Field, value: Any) -> bool:
    """Whether one value was given for all messages."""
    if field.size is None:
        return isinstance(value, str) or np.ndim(value) == 0
    if isinstance(value, bytes):
        return True
    first: Any = value[0] if len(value) else 0.0
    return (
        isinstance(first, str)
        if field.type in TEXTS
        else np.ndim(first) == 0 and not isinstance(first, bytes)
    )


def _bytes_to_arrays(value: Any) -> Any:
    """Bytes among the values as arrays of numbers."""
    packed = isinstance(value, list | tuple) and len(value) and isinstance(value[0], bytes)
    return [np.frombuffer(one, np.uint8) for one in value] if packed else value


def _encode_texts(field: Field, values: Sequence[Any], count: int) -> _Texts:
    known: dict[Any, int] = {}
    each = (str(one) if field.size is None else tuple(map(str, one)) for one in values)
    index = np.array([known.setdefault(one, len(known)) for one in each], np.int64)
    return _Texts(list(known), np.broadcast_to(index, (count,)) if len(index) == 1 else index)


def _serialise_layout_groups(
    definition: Definition, values: Mapping[str, Any], count: int
) -> Payloads:
    """All messages, grouped by layout."""
    keys = np.zeros(count, np.int64)
    for value in values.values():
        if isinstance(value, _Texts | list):
            shape = value.index if isinstance(value, _Texts) else [len(one) for one in value]
            _, keys = np.unique(np.column_stack([keys, shape]), axis=0, return_inverse=True)
    order = np.argsort(keys, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(keys[order])) + 1) if count else []
    fields = (
        list(_cdr_message_fields(definition, definition.root, values, rows)) for rows in groups
    )
    return cdr.merge_payloads(
        [
            (rows, cdr.serialise_messages(len(rows), own))
            for rows, own in zip(groups, fields, strict=True)
        ],
        count,
    )


def _cdr_message_fields(
    definition: Definition, type_: str, values: Mapping[str, Any], rows: Array, prefix: str = ""
) -> Iterator[cdr.CdrField]:
    """The fields of messages with the same layout, in order."""
    for field in definition.types[type_]:
        path = prefix + field.name
        if field.type in TEXTS:
            yield from _cdr_text_field(field, values.get(path), rows)
        elif field.type in TIMES and field.size is None:
            yield from cdr.cdr_time_field(
                values[path][rows] if path in values else np.zeros(len(rows), np.int64)
            )
        elif field.type in PRIMITIVES:
            yield _cdr_number_field(field, values.get(path), rows)
        elif field.size is None:
            yield from _cdr_message_fields(definition, field.type, values, rows, f"{path}.")
        elif field.size == -1:
            yield "uint32", 0
        else:
            raise FormatError(
                f"{definition.root}: {path} is a fixed array of messages, which cannot be written"
            )


def _cdr_text_field(field: Field, value: _Texts | None, rows: Array) -> Iterator[cdr.CdrField]:
    one = None if value is None else value.known[int(value.index[rows[0]])]
    if field.size is None:
        yield "string", one or ""
    elif field.size == -1:
        yield "string[]", list(one or ())
    else:
        yield from (("string", text) for text in (one or ("",) * field.size))


def _cdr_number_field(field: Field, value: Any, rows: Array) -> cdr.CdrField:
    kind = _CDR_NAMES.get(field.type, field.type)
    if field.size is None:
        return kind, 0 if value is None else value[rows]
    suffix = "[]" if field.size == -1 else "*"
    if value is None:
        return kind + suffix, np.zeros((len(rows), max(field.size, 0)))
    some = [value[int(row)] for row in rows] if isinstance(value, list) else value[rows]
    return kind + suffix, np.stack(_bytes_to_arrays(some)) if isinstance(some, list) else some

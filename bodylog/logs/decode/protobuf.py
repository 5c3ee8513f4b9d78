"""Decode protobuf with the FileDescriptorSet in the log: to dictionaries, or by position."""

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import FormatError
from ..records import Array, Batch, Topic
from .gather import gather_rows, make_template, match_template
from .layout import MessageLayout
from .message_path import Step
from .object_places import Item, Opaque, Place, list_plain_items, read_placed_column, text_at

FIXED = {1: "<d", 2: "<f", 6: "<Q", 7: "<I", 15: "<i", 16: "<q"}
MESSAGE = 11
STRING = 9
BYTES = 12
_GROUP = 10
DEEPEST = 64
_WIRES = {0: 0, 1: 8, 5: 4}
_LONGEST_VARINT = 10
_ZIGZAG = (17, 18)
Follow = Callable[..., Iterator[Item]]


@dataclass(frozen=True)
class ProtobufField:
    """One field of a message type; `type` names its message type."""

    name: str
    kind: int
    repeated: bool
    type: str


Types = Mapping[str, Mapping[int, ProtobufField]]
"""Message type -> field number -> field."""


class ProtobufLayout:
    """The layout of one message and of all with the same keys, lengths and widths of numbers."""

    def __init__(
        self,
        payload: bytes,
        types: Types,
        root: str,
        paths: Sequence[tuple[Step, ...]],
        follow: Follow,
    ) -> None:
        """FormatError or KeyError when the message is
        broken or a path cannot be followed by position.
        """
        walk = _Walk(payload, types)
        value = walk.message(0, len(payload), root, 0)
        self._items = [list(follow(value, steps, list_plain_items)) for steps in paths]
        layout = MessageLayout(len(payload), tuple(walk.constants + walk.pinned), ())
        self.width = len(payload)
        self._template = make_template(layout, payload, walk.high)

    def values(
        self, batch: Batch, index: Array, single: Sequence[int | None]
    ) -> tuple[Array, list[Array | tuple[str, ...]] | None]:
        """Which messages `index` (m,), all `width` long,
        have this layout (m,), and the paths' values.
        """
        rows = gather_rows(batch.data, batch.offset[index], 8 * self._template.words)
        same = match_template(rows, self._template)
        rows = rows if same.all() else rows[same]

        def numbers(places: Sequence[Place]) -> Array | None:
            parts = [_read_place_numbers(rows, place) for place in places]
            known = [part for part in parts if part is not None]
            return np.stack(known, axis=1) if len(known) == len(parts) else None

        found: list[Array | tuple[str, ...]] = []
        for some, alone in zip(self._items, single, strict=True):
            values = read_placed_column(some, alone, len(rows), numbers)
            if values is None:
                return same, None
            found.append(values)
        return same, found


class _Walk:
    """Reads one message by position: which bytes are
    constant, and of which only the highest bit is.
    """

    def __init__(self, payload: bytes, types: Types) -> None:
        self.payload = memoryview(payload)
        self.types = types
        self.constants: list[tuple[int, int]] = []
        self.high: list[tuple[int, int]] = []
        self.pinned: list[tuple[int, int]] = []

    def message(self, start: int, end: int, type_: str, depth: int) -> dict[str, Any]:
        """The message between two bytes, with positions in place of its values."""
        if depth > DEEPEST or type_ not in self.types:
            raise FormatError("no definition, or nested too deeply")
        fields = self.types[type_]
        out: dict[str, Any] = {field.name: _default_array_value(field) for field in fields.values()}
        for number, wire, at, stop in self._records(start, end):
            if number in fields:
                self._store(out, fields[number], wire, at, stop, depth)
            elif wire == 0:
                self._place(ProtobufField("", 0, False, ""), at, stop)
        return out

    def _records(self, start: int, end: int) -> Iterator[tuple[int, int, int, int]]:
        """Field number, wire type, and the byte range of each value."""
        pos = start
        while pos < end:
            key, at = read_varint(self.payload, pos)
            wire = key & 7
            stop = at
            if wire == 0:
                _, stop = read_varint(self.payload, at)
            elif wire == 2:
                length, at = read_varint(self.payload, at)
                stop = at + length
            elif wire in _WIRES:
                stop = at + _WIRES[wire]
            else:
                raise FormatError(f"wire type {wire}")
            if stop > end:
                raise FormatError("longer than its message")
            self.constants.append((pos, at))
            yield key >> 3, wire, at, stop
            pos = stop

    def _store(
        self, out: dict[str, Any], field: ProtobufField, wire: int, at: int, stop: int, depth: int
    ) -> None:
        if field.repeated and wire == 2 and field.kind not in (MESSAGE, STRING, BYTES):
            out[field.name].extend(self._packed(field, at, stop))
            return
        value = self._value(field, wire, at, stop, depth)
        if field.repeated:
            out[field.name].append(value)
        else:
            out[field.name] = value

    def _value(self, field: ProtobufField, wire: int, at: int, stop: int, depth: int) -> Any:
        if (wire == 2) != (field.kind in (MESSAGE, STRING, BYTES)):
            raise FormatError("a value of another kind than its field")
        if field.kind == MESSAGE:
            return self.message(at, stop, field.type, depth + 1)
        if field.kind == BYTES:
            return Opaque()
        if field.kind != STRING:
            return self._place(field, at, stop)
        content = bytes(self.payload[at:stop])
        (self.high if content.isascii() else self.constants).append((at, stop))
        return text_at(content.decode(), at, stop, self.pinned)

    def _packed(self, field: ProtobufField, at: int, stop: int) -> list[Place]:
        if field.kind in FIXED:
            size = np.dtype(FIXED[field.kind]).itemsize
            return [
                self._place(field, start, start + size)
                for start in range(at, stop - size + 1, size)
            ]
        found = []
        while at < stop:
            _, after = read_varint(self.payload[:stop], at)
            found.append(self._place(field, at, after))
            at = after
        return found

    def _place(self, field: ProtobufField, at: int, stop: int) -> Place:
        if field.kind in FIXED:
            if stop - at != np.dtype(FIXED[field.kind]).itemsize:
                raise FormatError("a number of another size than its field's")
        else:
            self.high.append((at, stop))
            if stop - at == _LONGEST_VARINT:
                self.constants.append((stop - 1, stop))
                if self.payload[stop - 1] != 1:
                    raise FormatError("a number beyond 64 bits")
        place = Place(0, at, stop, field.kind, self.pinned)
        number = _read_place_numbers(np.frombuffer(self.payload, np.uint8)[None], place)
        place.value = float("nan") if number is None else number[0].item()
        return place


def message_reader(topic: Topic) -> Callable[[bytes], Mapping[str, Any]]:
    """A function from payload to dictionary; FormatError
    when the descriptor set lacks the topic's type.
    """
    types, root = root_of(topic)
    return lambda payload: _decode_message(memoryview(payload), root, types, topic.name, 0)


def field_types(topic: Topic) -> dict[str, str]:
    """Field name -> message type ("" for plain values) of the topic's type."""
    types, root = root_of(topic)
    return {field.name: field.type for field in types[root].values()}


def root_of(topic: Topic) -> tuple[Types, str]:
    """The message types of a topic's schema and the type
    of its messages; FormatError for an invalid schema.
    """
    try:
        types = _read_descriptor_types(topic.definition)
    except (FormatError, UnicodeDecodeError, StopIteration):
        raise FormatError(f"{topic.name}: the schema is not a FileDescriptorSet") from None
    spelled = (topic.type, topic.type.replace("/msg/", "."), topic.type.replace("/", "."))
    root = next((name for name in spelled if name in types), None)
    if root is None:
        raise FormatError(
            f"{topic.name}: the schema defines no {topic.type}; it has "
            f"{', '.join(sorted(types)[:5])}"
        )
    return types, root


def _read_descriptor_types(descriptors: bytes) -> Types:
    found: dict[str, dict[int, ProtobufField]] = {}
    for number, file in _iterate_wire_records(memoryview(descriptors)):
        if number == 1:
            parts = list(_iterate_wire_records(file))
            package = next((bytes(value).decode() for n, value in parts if n == 2), "")
            for n, value in parts:
                if n == 4:
                    _describe_message_type(value, package, found, 0)
    return found


def _describe_message_type(
    message: Any, above: str, found: dict[str, dict[int, ProtobufField]], depth: int
) -> None:
    if depth > DEEPEST:
        raise FormatError("messages nested too deeply")
    parts = list(_iterate_wire_records(message))
    name = ".".join(
        filter(None, (above, next(bytes(value).decode() for n, value in parts if n == 1)))
    )
    found[name] = dict(_read_field_descriptor(value) for n, value in parts if n == 2)
    for n, value in parts:
        if n == 3:
            _describe_message_type(value, name, found, depth + 1)


def _read_field_descriptor(record: Any) -> tuple[int, ProtobufField]:
    parts = dict(_iterate_wire_records(record))
    name = bytes(parts.get(1, b"")).decode()
    type_ = bytes(parts.get(6, b"")).decode().lstrip(".")
    return int(parts.get(3, 0)), ProtobufField(name, int(parts.get(5, 0)), parts.get(4) == 3, type_)


def _iterate_wire_records(data: Any) -> Iterator[tuple[int, Any]]:
    """(field number, value): int for varints, the raw bytes for everything else."""
    if not isinstance(data, memoryview):
        raise FormatError("a number where a message was expected")
    pos = 0
    while pos < len(data):
        key, pos = read_varint(data, pos)
        wire = key & 7
        if wire == 0:
            value, pos = read_varint(data, pos)
            yield key >> 3, value
            continue
        if wire not in (1, 2, 5):
            raise FormatError(f"wire type {wire} at byte {pos}")
        length, pos = read_varint(data, pos) if wire == 2 else ({1: 8, 5: 4}[wire], pos)
        if length > len(data) - pos:
            raise FormatError(f"{length} bytes at byte {pos}, but {len(data) - pos} are left")
        yield key >> 3, data[pos : pos + length]
        pos += length


def read_varint(data: memoryview, pos: int) -> tuple[int, int]:
    """The number at byte `pos` and where it ends; FormatError when it is broken."""
    value = 0
    shift = 0
    while pos < len(data) and shift < 64:
        byte = data[pos]
        value |= (byte & 0x7F) << shift
        pos = pos + 1
        shift = shift + 7
        if byte < 0x80:
            return value, pos
    raise FormatError(f"a broken number at byte {pos}")


def _decode_message(
    data: memoryview, type_: str, types: Types, topic: str, depth: int
) -> dict[str, Any]:
    if depth > DEEPEST or type_ not in types:
        raise FormatError(
            f"{topic}: {f'no definition of {type_}' if type_ not in types else 'nested too deeply'}"
        )
    fields = types[type_]
    out: dict[str, Any] = {f.name: _default_value(f) for f in fields.values()}
    try:
        for number, raw in _iterate_wire_records(data):
            if number in fields:
                _store_field_value(out, fields[number], raw, types, topic, depth)
    except (FormatError, struct.error, UnicodeDecodeError) as error:
        raise FormatError(f"{topic}: {str(error).removeprefix(f'{topic}: ')}") from None
    return out


def _store_field_value(
    out: dict[str, Any], field: ProtobufField, raw: Any, types: Types, topic: str, depth: int
) -> None:
    if field.kind == MESSAGE:
        value = (
            _decode_message(raw, field.type, types, topic, depth + 1)
            if isinstance(raw, memoryview)
            else None
        )
    elif field.repeated and field.kind not in (STRING, BYTES) and isinstance(raw, memoryview):
        out[field.name].extend(_decode_packed_field(field, raw))
        return
    else:
        value = _decode_scalar(field.kind, raw)
    if field.repeated:
        out[field.name].append(value)
    else:
        out[field.name] = value


def _decode_packed_field(field: ProtobufField, raw: memoryview) -> list[Any]:
    if field.kind in FIXED:
        size = struct.calcsize(FIXED[field.kind])
        return list(
            struct.unpack(
                f"<{len(raw) // size}{FIXED[field.kind][1]}", raw[: len(raw) // size * size]
            )
        )
    values = []
    pos = 0
    while pos < len(raw):
        value, pos = read_varint(raw, pos)
        values.append(_decode_scalar(field.kind, value))
    return values


def _decode_scalar(kind: int, raw: Any) -> Any:
    if kind in FIXED:
        return struct.unpack(FIXED[kind], raw)[0]
    if kind in (STRING, BYTES):
        return bytes(raw).decode() if kind == STRING else bytes(raw)
    if not isinstance(raw, int):
        raise FormatError("bytes where a number was expected")
    if kind in (17, 18):
        return (raw >> 1) ^ -(raw & 1)
    if kind in (3, 5, 14):
        return raw - (1 << 64) if raw >> 63 else raw
    return raw


def _default_value(field: ProtobufField) -> Any:
    if field.repeated:
        return []
    if field.kind in (STRING, BYTES):
        return "" if field.kind == STRING else b""
    return None if field.kind in (MESSAGE, _GROUP) else 0


def _default_array_value(field: ProtobufField) -> Any:
    if field.repeated:
        return []
    if field.kind == STRING:
        return ""
    return {MESSAGE: None, BYTES: Opaque(), 1: 0.0, 2: 0.0}.get(field.kind, 0)


def _read_place_numbers(rows: Array, place: Place) -> Array | None:
    """The numbers (n,) at a place of rows (n,width): float64 or int64; None beyond 64 bits."""
    if place.kind in FIXED:
        kind = np.dtype(FIXED[place.kind])
        found = np.ndarray((len(rows),), kind, rows, place.at, (rows.shape[1],))
        wide = {"f": np.float64, "u": np.uint64, "i": np.int64}[kind.kind]
        return found.astype(wide) if kind.kind == "f" else _from_zigzag(found.astype(wide))
    value = np.zeros(len(rows), np.uint64)
    for k, at in enumerate(range(place.at, place.end)):
        value |= (rows[:, at] & 0x7F).astype(np.uint64) << np.uint64(7 * k)
    if place.kind in _ZIGZAG:
        return ((value >> np.uint64(1)) ^ (~(value & np.uint64(1)) + np.uint64(1))).view(np.int64)
    return value.view(np.int64) if place.kind in (3, 5, 14) else _from_zigzag(value)


def _from_zigzag(value: Array) -> Array | None:
    if value.dtype == np.uint64 and (value >> np.uint64(63)).any():
        return None
    return value.astype(np.int64)

"""Decode protobuf payloads to dictionaries, with the FileDescriptorSet in the log."""

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ...errors import FormatError
from ..records import Topic

FIXED = {1: "<d", 2: "<f", 6: "<Q", 7: "<I", 15: "<i", 16: "<q"}
MESSAGE = 11
STRING = 9
BYTES = 12
_BOOL = 8
_GROUP = 10
DEEPEST = 64


@dataclass(frozen=True)
class ProtobufField:
    """One field of a message type; `type` names its message type."""

    name: str
    kind: int
    repeated: bool
    type: str


Types = Mapping[str, Mapping[int, ProtobufField]]
"""Message type -> field number -> field."""


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
    value = shift = 0
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

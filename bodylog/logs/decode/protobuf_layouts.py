"""Decode protobuf messages all at once that have
the same fields in the same order, and equal length.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from ...errors import FormatError
from ..records import Array, Batch
from .gather import gather_rows, make_template, match_template
from .layout import MessageLayout
from .message_path import Step
from .object_places import Item, Opaque, Place, list_plain_items, read_placed_column, text_at
from .protobuf import BYTES, DEEPEST, FIXED, MESSAGE, STRING, ProtobufField, Types, read_varint

_WIRES = {0: 0, 1: 8, 5: 4}
_LONGEST_VARINT = 10
_ZIGZAG = (17, 18)
Follow = Callable[..., Iterator[Item]]


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
        self.width, self._template = len(payload), make_template(layout, payload, walk.high)

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
            return None if any(part is None for part in parts) else np.stack(parts, axis=1)  # type: ignore[arg-type]

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


def _default_array_value(field: ProtobufField) -> Any:
    if field.repeated:
        return []
    if field.kind == STRING:
        return ""
    return {MESSAGE: None, BYTES: Opaque(), 1: 0.0, 2: 0.0}.get(field.kind, 0)


def _read_place_numbers(rows: Array, place: Place) -> Array | None:
    """The numbers (n,) at a place of rows (n,width):
    float64 or int64; None if one exceeds 64 bits.
    """
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

"""Serialise many ROS 2 messages of one layout at
once: little-endian CDR through a structured dtype.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..records import Array

CdrField = tuple[str, Any]
"""(kind, value): a primitive with an array (n,) or a constant · `string`, `string[]` with constants
· `<primitive>*` a fixed array (n,k) · `<primitive>[]` a sequence (n,k).
"""

PRIMITIVES = {
    "bool": "u1",
    "uint8": "u1",
    "int8": "i1",
    "uint16": "<u2",
    "int16": "<i2",
    "uint32": "<u4",
    "int32": "<i4",
    "uint64": "<u8",
    "int64": "<i8",
    "float32": "<f4",
    "float64": "<f8",
}
_ENCAPSULATION = np.array([0, 1, 0, 0], np.uint8)


@dataclass(frozen=True, eq=False)
class Payloads:
    """n payloads: number i is data[offset[i] : offset[i] + length[i]], data (bytes,) uint8."""

    data: Array
    offset: Array
    length: Array


def cdr_time_field(ns: Array) -> list[CdrField]:
    """builtin_interfaces/Time or Duration from int64 ns (n,)."""
    return [("int32", ns // 1_000_000_000), ("uint32", ns % 1_000_000_000)]


def cdr_header_field(ns: Array, frame_id: str = "") -> list[CdrField]:
    """std_msgs/Header from int64 stamps in ns (n,)."""
    return [*cdr_time_field(ns), ("string", frame_id)]


def serialise_messages(count: int, fields: Sequence[CdrField]) -> Payloads:
    """Serialise `count` messages of these `fields` in order, all of one length."""
    layout = _Layout()
    for kind, value in fields:
        layout.add(kind, value)
    rows = np.zeros(count, layout.dtype())
    rows["encapsulation"] = _ENCAPSULATION
    with np.errstate(invalid="ignore"):  # a signalling NaN stays a NaN when it becomes a float32
        for name, value in layout.values.items():
            rows[name] = value
    size = rows.dtype.itemsize
    return Payloads(rows.view(np.uint8).reshape(-1), np.arange(count) * size, np.full(count, size))


def merge_payloads(parts: Sequence[tuple[Array, Payloads]], count: int) -> Payloads:
    """Groups of payloads in one order: each part lists which of the `count` messages it holds."""
    offset = np.zeros(count, np.int64)
    length = np.zeros(count, np.int64)
    start = 0
    for index, part in parts:
        offset[index] = part.offset + start
        length[index] = part.length
        start += part.data.size
    data = np.concatenate([part.data for _, part in parts]) if parts else np.zeros(0, np.uint8)
    return Payloads(data, offset, length)


class _Layout:
    """The offset of each field: CDR aligns to a field's own
    size, counted from the end of the encapsulation header.
    """

    def __init__(self) -> None:
        self.position = 4
        self.columns: list[tuple[str, Any, int]] = [("encapsulation", (np.uint8, (4,)), 0)]
        self.values: dict[str, Any] = {}

    def add(self, kind: str, value: Any) -> None:
        """Place one field."""
        if kind == "string":
            self._string(value)
        elif kind == "string[]":
            self._put("<u4", 4, len(value))
            for text in value:
                self._string(text)
        elif kind.endswith("[]"):
            self._put("<u4", 4, value.shape[1])
            self._array(PRIMITIVES[kind[:-2]], value)
        elif kind.endswith("*"):
            self._array(PRIMITIVES[kind[:-1]], value)
        else:
            self._put(PRIMITIVES[kind], np.dtype(PRIMITIVES[kind]).itemsize, value)

    def dtype(self) -> "np.dtype[np.void]":
        """The layout so far as a structured dtype."""
        names, formats, offsets = zip(*self.columns, strict=True)
        return np.dtype(
            {"names": names, "formats": formats, "offsets": offsets, "itemsize": self.position}
        )

    def _string(self, text: str) -> None:
        raw = np.frombuffer(text.encode(errors="backslashreplace") + b"\0", np.uint8)
        self._put("<u4", 4, raw.size)
        self._put((np.uint8, raw.shape), 1, raw)

    def _array(self, base: str, value: Array) -> None:
        if value.shape[1]:
            self._put((base, value.shape[1:]), np.dtype(base).itemsize, value)

    def _put(self, form: Any, align: int, value: Any) -> None:
        start = 4 + -(-(self.position - 4) // align) * align
        name = f"f{len(self.columns)}"
        self.columns.append((name, form, start))
        self.values[name] = value
        self.position = start + np.dtype(form).itemsize

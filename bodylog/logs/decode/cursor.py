"""A cursor over one CDR or ROS 1 payload that records where each field of the definition begins."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...errors import FormatError
from ..records import Array
from .definitions import PRIMITIVES, TEXTS, TIMES, Definition, Field
from .message_path import IndexRange, Only, Step, is_index

CDR_KINDS = {(0, 0): (True, 8), (0, 1): (False, 8), (0, 6): (True, 4), (0, 7): (False, 4)}
"""First two bytes of a CDR payload -> (big endian, largest alignment)."""

Payload = bytes | memoryview
"""One message's bytes."""

_SIZES = {name: int(code[1]) for name, code in PRIMITIVES.items()}
_RANGE_ALL = IndexRange(0, -1)
Wanted = Sequence[tuple[int, tuple[Step, ...]]]


class FieldLeaf(NamedTuple):
    """One requested field: byte offsets (K,), element dtype
    · texts, if text · single: neither array nor slice.
    """

    offsets: Array
    dtype: np.dtype[np.generic]
    texts: tuple[str, ...] | None
    single: bool


class CdrCursor:
    """A cursor over one payload that records constants and positions of requested fields."""

    def __init__(self, definition: Definition, payload: Payload, wanted: int, ros1: bool) -> None:
        """Start at the payload's first field; FormatError when it is not plain CDR."""
        self.definition = definition
        self.payload = payload
        self.origin = 0 if ros1 else 4
        self.pos = self.origin
        self.constants: list[tuple[int, int]] = [] if ros1 else [(0, 2)]
        self.big, self.largest = (False, 1) if ros1 else _cdr_kind(definition.root, payload)
        self.ros1 = ros1
        self.runs: list[list[tuple[int, int, int]]] = [[] for _ in range(wanted)]
        self.texts: list[list[str]] = [[] for _ in range(wanted)]
        self._least: dict[str, int] = {}
        self._fixed: dict[str, bool] = {}

    def struct(self, type_: str, wanted: Wanted, final: bool) -> None:
        """Read all fields of a struct; with `final`, only up to the last requested one."""
        fields = self.definition.types[type_]
        wanted = self._matching(type_, wanted)
        inner = [tuple((k, steps[1:]) for k, steps in wanted if steps[0] == f.name) for f in fields]
        last = (
            max((n for n, some in enumerate(inner) if some), default=-1)
            if final
            else len(fields) - 1
        )
        for number in range(last + 1):
            self._field(fields[number], inner[number], final and number == last)

    def _field(self, field: Field, wanted: Wanted, final: bool) -> None:
        if field.size is None:
            self._value(field.type, wanted, final)
            return
        count = self._count() if field.size < 0 else field.size
        if field.type in _SIZES:
            self._numbers(field.type, count, wanted)
        else:
            self._items(field.type, count, wanted, final)

    def _value(self, type_: str, wanted: Wanted, final: bool) -> None:
        if type_ in _SIZES:
            self._numbers(type_, 1, wanted)
        elif type_ in TIMES:
            self._time(type_, wanted)
        elif type_ in TEXTS:
            self._text(type_, wanted)
        elif self._least_size(type_):
            self.struct(type_, wanted, final)

    def _numbers(self, type_: str, count: int, wanted: Wanted) -> None:
        size = _SIZES[type_]
        if count:
            self._align(size)
            self._need(count * size, f"{count} {type_}")
        for k, steps in wanted:
            picked = _slice_range(steps, count)
            missing = not picked and bool(steps) and is_index(steps[0])
            self.runs[k].append(
                (-1, 1, size) if missing else (self.pos + picked.start * size, len(picked), size)
            )
        self.pos += count * size

    def _time(self, type_: str, wanted: Wanted) -> None:
        self._align(4)
        self._need(8, type_)
        for k, steps in wanted:
            second = bool(steps) and steps[0] in ("nsecs", "nanosec")
            self.runs[k].append((self.pos + 4 * second, 1, 8))
        self.pos += 8

    def _text(self, type_: str, wanted: Wanted) -> None:
        wide = self.definition.wide if type_ == "wstring" else 1
        if not wide:
            raise FormatError(
                f"{self.definition.root}: a wstring; writers disagree on the size of its characters"
            )
        length = self._count() * wide
        self._need(length, f"a text of {length} bytes")
        if wanted:
            self.constants.append((self.pos, self.pos + length))
            text = str(
                self.payload[self.pos : self.pos + length], self._code(type_), "replace"
            ).removesuffix("\0")
            for k, _ in wanted:
                self.texts[k].append(text)
        self.pos += length

    def _code(self, type_: str) -> str:
        if type_ == "string":
            return "utf-8"
        return f"utf-{32 if self.definition.wide == 4 else 16}-{'be' if self.big else 'le'}"

    def _items(self, type_: str, count: int, wanted: Wanted, final: bool) -> None:
        least = self._least_size(type_)
        self._need(count * least, f"{count} {type_}")
        if not count or not least:
            return
        if not wanted and self._is_fixed(type_):
            self._skip(type_, count)
            return
        picks = [(k, _slice_range(steps, count), steps[1:]) for k, steps in wanted]
        last = (
            max((picked[-1] for _, picked, _ in picks if picked), default=-1)
            if final
            else count - 1
        )
        for index in range(last + 1):
            inner = tuple((k, steps) for k, picked, steps in picks if index in picked)
            self._value(type_, inner, final and index == last)

    def _matching(self, type_: str, wanted: Wanted) -> Wanted:
        """The requested paths whose filters this struct
        passes; the values compared must stay constant.
        """
        passed = []
        for k, steps in wanted:
            if not isinstance(steps[0], Only) or self._equals(type_, steps[0]):
                passed.append((k, steps[1:] if isinstance(steps[0], Only) else steps))
        return passed

    def _equals(self, type_: str, only: Only) -> bool:
        probe = CdrCursor(self.definition, self.payload, 1, self.ros1)
        probe.pos = self.pos
        probe.struct(type_, ((0, (only.field,)),), True)
        self.constants += probe.constants
        if probe.texts[0]:
            return probe.texts[0] == [only.value]
        field = next(f for f in self.definition.types[type_] if f.name == only.field)
        offset, _, size = probe.runs[0][0]
        self.constants.append((offset, offset + size))
        return bool(
            np.frombuffer(self.payload, self._dtype(field.type), 1, offset)[0] == only.value
        )

    def _skip(self, type_: str, count: int) -> None:
        """Skip fixed-size structs: their sizes repeat once the alignment does."""
        spans: list[int] = []
        seen: dict[int, int] = {}
        while (
            len(spans) < count and (residue := (self.pos - self.origin) % self.largest) not in seen
        ):
            seen[residue] = len(spans)
            before = self.pos
            self._value(type_, (), False)
            spans.append(self.pos - before)
        if len(spans) < count:
            cycle = spans[seen[residue] :]
            whole, part = divmod(count - len(spans), len(cycle))
            self._need(whole * sum(cycle) + sum(cycle[:part]), f"{count} {type_}")
            self.pos += whole * sum(cycle) + sum(cycle[:part])

    def _count(self) -> int:
        self._align(4)
        self._need(4, "a length")
        self.constants.append((self.pos, self.pos + 4))
        count = int.from_bytes(
            self.payload[self.pos : self.pos + 4], "big" if self.big else "little"
        )
        self.pos += 4
        return count

    def _align(self, size: int) -> None:
        self.pos += (self.origin - self.pos) % min(size, self.largest)

    def _need(self, size: int, what: str) -> None:
        left = len(self.payload) - self.pos
        if size > left:
            raise FormatError(
                f"{self.definition.root}: {what} at byte {self.pos}, but {max(left, 0)} "
                "bytes are left"
            )

    def _is_fixed(self, type_: str) -> bool:
        if type_ not in self._fixed:
            fields = self.definition.types.get(type_, ())
            self._fixed[type_] = type_ not in TEXTS and all(
                f.size != -1 and self._is_fixed(f.type) for f in fields
            )
        return self._fixed[type_]

    def _least_size(self, type_: str) -> int:
        """Fewest bytes a value can take, without padding."""
        if type_ in _SIZES or type_ in TIMES or type_ in TEXTS:
            return _SIZES.get(type_, 8 if type_ in TIMES else 4)
        if type_ not in self._least:
            sizes = (
                (f, 4 if f.size == -1 else self._least_size(f.type))
                for f in self.definition.types[type_]
            )
            self._least[type_] = sum(
                size * (f.size if f.size is not None and f.size >= 0 else 1) for f, size in sizes
            )
        return self._least[type_]

    def _dtype(self, type_: str) -> np.dtype[np.generic]:
        order = ">" if self.big else "<"
        if type_ in TIMES:
            # ROS 2's int32 overflows in 2038; later stamps continue as unsigned
            seconds = "i4" if type_ == "duration" or type_.endswith("/Duration") else "u4"
            return np.dtype([("sec", order + seconds), ("nanosec", order + "u4")])
        return np.dtype("V0") if type_ in TEXTS else np.dtype(order + PRIMITIVES[type_])

    def leaf(self, k: int, end: tuple[Field, bool]) -> FieldLeaf:
        """The recorded positions of the k-th requested path."""
        field, single = end
        start, count, stride = np.array(self.runs[k], np.int64).reshape(-1, 3).T
        number = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        offsets = np.repeat(start, count) + np.repeat(stride, count) * number
        return FieldLeaf(
            offsets,
            self._dtype(field.type),
            tuple(self.texts[k]) if field.type in TEXTS else None,
            single,
        )

    def single(self, k: int, end: tuple[Field, bool]) -> str | int | float | memoryview:
        """The value of the k-th requested path, as one value."""
        field, single = end
        if field.type in TEXTS:
            return "".join(self.texts[k][:1])
        offset, count, size = self.runs[k][0]
        raw = memoryview(self.payload)[offset : offset + count * size]
        value: int | float = (
            np.frombuffer(raw, self._dtype(field.type), 1)[0].item() if single else 0
        )
        return value if single else raw


def _cdr_kind(root: str, payload: Payload) -> tuple[bool, int]:
    kind = tuple(payload[:2])
    if len(payload) < 4 or kind not in CDR_KINDS:
        raise FormatError(
            f"{root}: the payload begins with {payload[:4].hex() or 'nothing'}, which is not "
            "plain CDR"
        )
    return CDR_KINDS[kind]


def _slice_range(steps: tuple[Step, ...], count: int) -> range:
    step = steps[0] if steps else _RANGE_ALL
    return step.of(count) if isinstance(step, IndexRange) else range(count)

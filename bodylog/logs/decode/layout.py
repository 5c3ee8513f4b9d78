"""Locate each requested field in a message's bytes by one pass over a CDR or ROS 1 payload."""

from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from typing import NamedTuple

from ...errors import ConfigError, FormatError
from .cursor import CdrCursor, FieldLeaf, Payload
from .definitions import PRIMITIVES, TEXTS, TIMES, Definition, Field
from .message_path import Only, Step, is_index

_PADDING = 4


class MessageLayout(NamedTuple):
    """One layout: bytes examined, the (start, stop)
    byte ranges that define it, the requested leaves.
    """

    width: int
    constants: tuple[tuple[int, int], ...]
    leaves: tuple[FieldLeaf, ...]


def leaf_field(definition: Definition, steps: tuple[Step, ...]) -> tuple[Field, bool]:
    """The field at the end of `steps`, and whether it
    is one value; ConfigError suggests existing fields.
    """
    field = Field("", definition.root, None)
    single = True
    for step in steps:
        if isinstance(step, str):
            field = _find_member(definition, field, step)
        elif isinstance(step, Only):
            _parse_element_filter(definition, field, step)
            single = False
        elif field.size is None:
            raise ConfigError(
                f"{definition.root}: {field.name or 'the message'} is not an array; leave "
                "out the brackets"
            )
        else:
            single = single and is_index(step)
            field = Field(field.name, field.type, None)
    if not (field.type in PRIMITIVES or field.type in TEXTS or field.type in TIMES):
        names = ", ".join(f.name for f in definition.types[field.type])
        raise ConfigError(
            f"{definition.root}: {field.name or 'the message'} is a {field.type}; name one "
            f"of {names}"
        )
    return field, single and field.size is None


def _find_member(definition: Definition, field: Field, name: str) -> Field:
    if field.size is not None:
        raise ConfigError(
            f"{definition.root}: {field.name} is an array; write {field.name}[:].{name}"
        )
    members = {f.name: f for f in _definition_fields(definition, field.type)}
    if name not in members:
        there = ", ".join(members) or "none"
        raise ConfigError(f"{definition.root}: {field.type} has no field {name!r}; it has {there}")
    return members[name]


def _parse_element_filter(definition: Definition, field: Field, only: Only) -> None:
    key = _find_member(definition, field, only.field)
    if key.size is not None or not (key.type in PRIMITIVES or key.type in TEXTS):
        raise ConfigError(
            f"{definition.root}: a filter compares a number or a text, and {only.field} is a "
            f"{key.type}"
        )


def _definition_fields(definition: Definition, type_: str) -> tuple[Field, ...]:
    if type_ in TIMES:
        names = ("secs", "nsecs") if type_ in ("time", "duration") else ("sec", "nanosec")
        seconds = "uint32" if type_ == "time" else "int32"
        return (Field(names[0], seconds, None), Field(names[1], "uint32", None))
    return definition.types.get(type_, ())


def locate_fields(
    definition: Definition, payload: Payload, wanted: Sequence[tuple[Step, ...]], ros1: bool
) -> MessageLayout:
    """The layout of `payload` up to the last requested
    field; FormatError when it contradicts itself.
    """
    walker = CdrCursor(definition, payload, len(wanted), ros1)
    walker.struct(definition.root, tuple(enumerate(wanted)), bool(wanted))
    leaves = tuple(walker.leaf(k, leaf_field(definition, steps)) for k, steps in enumerate(wanted))
    constants = _merge_byte_ranges(walker.constants)
    # a filter may read further than the last requested field
    return MessageLayout(max([walker.pos, *(stop for _, stop in constants)]), constants, leaves)


def count_unread_bytes(definition: Definition, payload: Payload, ros1: bool) -> int:
    """Bytes left over after reading all of `payload`."""
    return len(payload) - locate_fields(definition, payload, (), ros1).width


def fit_wstring_size(definition: Definition, payload: Payload, ros1: bool) -> list[Definition]:
    """The definition with the wstring character sizes, in
    bytes, for which `payload` has its declared length.

    Writers count characters of 2 or 4 bytes, or bytes. One
    definition, or all if no wstring distinguishes them.
    """
    fits: dict[int, list[Definition]] = {}
    unknown = not definition.wide and any(
        f.type == "wstring" for some in definition.types.values() for f in some
    )
    for size in (1, 2, 4) if unknown else ():
        sized = definition._replace(wide=size)
        with suppress(FormatError):
            fits.setdefault(count_unread_bytes(sized, payload, ros1), []).append(sized)
    least = min(fits, default=_PADDING)
    return fits[least] if least < _PADDING and len(fits[least]) != 2 else []


class Picker:
    """Reads single fields of message after message:
    texts and numbers as values, arrays as their bytes.

    If only the length of the last requested bytes differs
    from the previous message, its layout is reused.
    """

    def __init__(
        self, definition: Definition, wanted: Sequence[tuple[Step, ...]], ros1: bool
    ) -> None:
        """For messages of one definition and dialect; ConfigError suggests existing fields."""
        self._definition = definition
        self._wanted = wanted
        self._ros1 = ros1
        self._ends = tuple(leaf_field(definition, steps) for steps in wanted)
        self._last: CdrCursor | None = None

    def __call__(self, payload: Payload) -> tuple[str | int | float | memoryview, ...]:
        """Requested fields of one message; FormatError if it contradicts itself. Thread safe."""
        walker = _reuse_cursor(self._last, payload) if self._last else None
        if walker is None:
            walker = CdrCursor(self._definition, payload, len(self._wanted), self._ros1)
            walker.struct(self._definition.root, tuple(enumerate(self._wanted)), True)
            self._last = walker
        return tuple(walker.single(k, end) for k, end in enumerate(self._ends))


def _reuse_cursor(last: CdrCursor, payload: Payload) -> CdrCursor | None:
    """A cursor for a payload that differs from the last
    one only in the length of its final bytes, or None.
    """
    start, stop = last.constants[-1] if last.constants else (0, 0)
    tail = [[(stop, last.pos - stop, 1)] == runs for runs in last.runs]
    if True not in tail or any(payload[a:b] != last.payload[a:b] for a, b in last.constants[:-1]):
        return None
    count = int.from_bytes(payload[start:stop], "big" if last.big else "little")
    if len(payload) < stop + count:
        return None
    walker = copy(last)
    walker.payload = payload
    walker.pos = stop + count
    walker.runs = [
        [(stop, count, 1)] if ends else runs for ends, runs in zip(tail, last.runs, strict=True)
    ]
    return walker


def _merge_byte_ranges(ranges: list[tuple[int, int]]) -> tuple[tuple[int, int], ...]:
    merged: list[tuple[int, int]] = []
    for start, stop in sorted(set(ranges)):
        if merged and start <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(stop, merged[-1][1]))
        else:
            merged.append((start, stop))
    return tuple(merged)

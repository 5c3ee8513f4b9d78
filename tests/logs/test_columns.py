"""Columns must equal what rosbags decodes message by message, for any definition; damage must be counted, not guessed."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bodylog.errors import ConfigError, FormatError
from bodylog.logs.columns import Columns, columns
from bodylog.types import Batch, Topic

ROOT, INNER, LEAF = "test_msgs/msg/Root", "test_msgs/msg/Inner", "test_msgs/msg/Leaf"
NUMBERS = ("bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64")
RANGES = {name: np.iinfo(name) for name in NUMBERS if "int" in name}


@dataclass(frozen=True)
class Member:
    name: str
    type: str
    size: str


class Messages:
    """A log of one topic held in memory, a few messages to a batch."""

    def __init__(self, payloads: list[bytes], batch: int = 4) -> None:
        self.payloads, self.batch = payloads, batch

    def batches(self, ids: Any = None) -> Iterator[Batch]:
        for start in range(0, len(self.payloads), self.batch):
            some = self.payloads[start : start + self.batch]
            length = np.array([len(payload) for payload in some], np.int64)
            data = np.frombuffer(b"".join(some), np.uint8)
            yield Batch(1, np.arange(start, start + len(some)), data, np.cumsum(length) - length, length)


def topic(text: str, encoding: str = "cdr", type_: str = ROOT, messages: int = 0) -> Topic:
    dialect = "ros1msg" if encoding == "ros1" else "ros2msg"
    return Topic(1, "/x", type_, encoding, text.encode(), dialect, messages)


def members(types: tuple[str, ...]) -> st.SearchStrategy[tuple[Member, ...]]:
    kinds = st.tuples(st.sampled_from(types), st.sampled_from(("", "", "", "[]", "[3]", "[1]", "[<=5]")))
    return st.lists(kinds, min_size=1, max_size=5).map(
        lambda some: tuple(Member(f"f{n}", type_, size) for n, (type_, size) in enumerate(some))
    )


@st.composite
def cases(draw: st.DrawFn, ros1: bool) -> tuple[dict[str, tuple[Member, ...]], list[dict[str, Any]]]:
    plain = (*NUMBERS, "string", "time" if ros1 else "builtin_interfaces/Time")
    types = {
        LEAF: draw(members(plain)),
        INNER: draw(members((*plain, "test_msgs/Leaf"))),
        ROOT: draw(members((*plain, "test_msgs/Leaf", "test_msgs/Inner"))),
    }
    if ros1:
        types = {k: tuple(Member(m.name, m.type, m.size.replace("[<=5]", "[]")) for m in v) for k, v in types.items()}
    count = draw(st.integers(1, 9))
    return types, [draw(values(types, ROOT)) for _ in range(count)]


@st.composite
def values(draw: st.DrawFn, types: dict[str, tuple[Member, ...]], root: str) -> dict[str, Any]:
    return {m.name: draw(value(types, m)) for m in types[root]}


@st.composite
def value(draw: st.DrawFn, types: dict[str, tuple[Member, ...]], member: Member) -> Any:
    if not member.size:
        return draw(one(types, member.type))
    digits = member.size.strip("[]<=")
    count = int(digits) if digits and "<" not in member.size else draw(st.integers(0, 2))
    return [draw(one(types, member.type)) for _ in range(count)]


@st.composite
def one(draw: st.DrawFn, types: dict[str, tuple[Member, ...]], type_: str) -> Any:
    if type_ == "string":
        return draw(st.sampled_from(("", "a", "abc", "joint_1", "käse")))
    if type_ in ("time", "builtin_interfaces/Time"):
        return (draw(st.integers(0, 2**31 - 1)), draw(st.integers(0, 999_999_999)))
    if type_ == "bool":
        return draw(st.booleans())
    if type_.startswith("float"):
        return draw(st.floats(width=int(type_[5:]), allow_nan=True))
    if type_ in RANGES:
        return draw(st.integers(int(RANGES[type_].min), int(RANGES[type_].max)))
    return draw(values(types, type_.replace("/", "/msg/")))


def text_of(types: dict[str, tuple[Member, ...]]) -> str:
    def body(name: str) -> str:
        return "".join(f"{m.type}{m.size} {m.name}  # a remark\n" for m in types[name])

    rule = "=" * 80
    parts = [body(ROOT), *(f"MSG: {name.replace('/msg/', '/')}\n{body(name)}" for name in (INNER, LEAF))]
    return f"\n{rule}\n".join(parts)


def encode(types: dict[str, tuple[Member, ...]], messages: list[dict[str, Any]], kind: str) -> list[bytes]:
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    for name in (LEAF, INNER, ROOT):
        body = "".join(f"{m.type}{m.size} {m.name}\n" for m in types[name])
        store.register(get_types_from_msg(body, name))
    objects = [_object(store, types, ROOT, message) for message in messages]
    if kind == "ros1":
        return [bytes(store.serialize_ros1(o, ROOT)) for o in objects]
    return [bytes(store.serialize_cdr(o, ROOT, little_endian=kind == "little")) for o in objects]


def _object(store: Any, types: dict[str, tuple[Member, ...]], name: str, message: dict[str, Any]) -> Any:
    return store.types[name](**{m.name: _member(store, types, m, message[m.name]) for m in types[name]})


def _member(store: Any, types: dict[str, tuple[Member, ...]], member: Member, held: Any) -> Any:
    def single(x: Any) -> Any:
        if member.type in ("time", "builtin_interfaces/Time"):
            return store.types["builtin_interfaces/msg/Time"](*x)
        if member.type.startswith("test_msgs"):
            return _object(store, types, member.type.replace("/", "/msg/"), x)
        return x

    if not member.size:
        return single(held)
    return np.array(held, member.type) if member.type in NUMBERS else [single(x) for x in held]


def paths(types: dict[str, tuple[Member, ...]], name: str = ROOT, above: str = "") -> list[str]:
    found = []
    for m in types[name]:
        here = above + m.name
        nested = m.type.startswith("test_msgs")
        if nested:
            found += paths(types, m.type.replace("/", "/msg/"), f"{here}{'[:]' if m.size else ''}.")
        else:
            found.append(here)
    return found


def expected(held: Any, path: str) -> list[Any]:
    if not path:
        return [x for item in held for x in expected(item, "")] if isinstance(held, list) else [held]
    first, _, rest = path.partition(".")
    inner = held[first.removesuffix("[:]")]
    items = inner if first.endswith("[:]") else [inner]
    return [x for item in items for x in expected(item, rest)]


def check(found: Columns, messages: list[dict[str, Any]], fields: list[str]) -> None:
    assert not found.rejected
    np.testing.assert_array_equal(found.sound, np.arange(len(messages)))
    for part in found.parts:
        for place, row in enumerate(part.rows.tolist()):
            for path, got in zip(fields, part.values, strict=True):
                want = expected(messages[row], path)
                if isinstance(got, tuple):
                    assert list(got) == want
                    continue
                if want and isinstance(want[0], tuple):
                    want = [seconds * 10**9 + nanoseconds for seconds, nanoseconds in want]
                width = got.dtype if got.dtype.kind == "f" else None
                np.testing.assert_array_equal(np.atleast_1d(got[place]), np.array(want, width or got.dtype))


@pytest.mark.parametrize("kind", ["little", "big", "ros1"])
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_any_definition_and_values_decode_as_rosbags_wrote_them(kind: str, data: st.DataObject) -> None:
    types, messages = data.draw(cases(kind == "ros1"))
    payloads = encode(types, messages, kind)
    fields = paths(types)
    found = columns(Messages(payloads), topic(text_of(types), "ros1" if kind == "ros1" else "cdr"), fields)
    assert found.fast + found.fallback == len(messages)
    check(found, messages, fields)


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_any_one_field_alone_decodes_the_same(data: st.DataObject) -> None:
    types, messages = data.draw(cases(False))
    field = data.draw(st.sampled_from(paths(types)))
    check(columns(Messages(encode(types, messages, "little")), topic(text_of(types)), [field]), messages, [field])


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_damaged_payloads_are_counted_and_never_crash(data: st.DataObject) -> None:
    types, messages = data.draw(cases(False))
    payloads = encode(types, messages, "little")
    place = data.draw(st.integers(0, len(payloads) - 1))
    cut = data.draw(st.integers(0, len(payloads[place])))
    flips = data.draw(st.lists(st.tuples(st.integers(0, 10**6), st.integers(1, 255)), max_size=3))
    broken = bytearray(payloads[place][:cut])
    for where, bits in flips if broken else ():
        broken[where % len(broken)] ^= bits
    payloads[place] = bytes(broken)
    found = columns(Messages(payloads), topic(text_of(types)), paths(types))
    assert len(found.sound) + sum(found.rejected.values()) == len(messages)

"""Columns equal what rosbags decodes message by message, for any definition; damage is counted."""

import json
import struct
import tracemalloc
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bodylog.errors import ConfigError, FormatError
from bodylog.logs.decode.columns import read_topic_columns
from bodylog.logs.decode.parts import TopicColumns
from bodylog.types import Topic
from tests.logs.memory_logs import Messages

from .writing import T0, joint_state

ROOT, INNER, LEAF = "test_msgs/msg/Root", "test_msgs/msg/Inner", "test_msgs/msg/Leaf"
INTEGERS = tuple(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
NUMBERS = ("bool", "byte", "char", *INTEGERS, "float32", "float64")
RANGES = {name: np.iinfo(name) for name in INTEGERS}
DTYPES = {name: np.dtype({"byte": "uint8", "char": "uint8"}.get(name, name)) for name in NUMBERS}


@dataclass(frozen=True)
class Member:
    name: str
    type: str
    size: str


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
    if type_ in ("byte", "char"):
        return draw(st.integers(0, 127))
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
    return np.array(held, DTYPES[member.type]) if member.type in NUMBERS else [single(x) for x in held]


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


def check(found: TopicColumns, messages: list[dict[str, Any]], fields: list[str]) -> None:
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
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_columns_equal_rosbags_for_any_definition(kind: str, data: st.DataObject) -> None:
    types, messages = data.draw(cases(kind == "ros1"))
    payloads = encode(types, messages, kind)
    fields = paths(types)
    found = read_topic_columns(Messages(payloads), topic(text_of(types), "ros1" if kind == "ros1" else "cdr"), fields)
    assert found.fast + found.fallback == len(messages)
    check(found, messages, fields)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_columns_of_one_field_equal_those_of_all(data: st.DataObject) -> None:
    types, messages = data.draw(cases(False))
    field = data.draw(st.sampled_from(paths(types)))
    check(read_topic_columns(Messages(encode(types, messages, "little")), topic(text_of(types)), [field]), messages, [field])


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_columns_count_damaged_payloads(data: st.DataObject) -> None:
    types, messages = data.draw(cases(False))
    payloads = encode(types, messages, "little")
    place = data.draw(st.integers(0, len(payloads) - 1))
    cut = data.draw(st.integers(0, len(payloads[place])))
    flips = data.draw(st.lists(st.tuples(st.integers(0, 10**6), st.integers(1, 255)), max_size=3))
    broken = bytearray(payloads[place][:cut])
    for where, bits in flips if broken else ():
        broken[where % len(broken)] ^= bits
    payloads[place] = bytes(broken)
    found = read_topic_columns(Messages(payloads), topic(text_of(types)), paths(types))
    assert len(found.sound) + sum(found.rejected.values()) == len(messages)


JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
"""
SKIN = """SkinCellData[] data
=====
MSG: test_msgs/SkinCellData
int32 cellId
int64 ts
float32[] prox
float32[] force
"""
JOINT_FIELDS = ("header.stamp", "name", "position")


def joint_topic(encoding: str = "cdr") -> Topic:
    return topic(JOINT_STATE, encoding, "sensor_msgs/msg/JointState")


def test_columns_accept_trailing_bytes_and_empty_velocities():
    plain = joint_state(T0, ("a", "b"), (1.0, 2.0))
    payloads = [plain, plain + bytes(8), joint_state(T0, ("a", "b"), (3.0, 4.0), (np.nan, np.nan))]
    found = read_topic_columns(Messages(payloads), joint_topic(), JOINT_FIELDS)
    assert (found.fast, found.fallback, dict(found.rejected)) == (3, 0, {})
    np.testing.assert_array_equal(found.column("position"), [[1, 2], [1, 2], [3, 4]])


def test_columns_separate_layouts_of_equal_length():
    payloads = [
        joint_state(T0, ("aa", "bb"), (1.0, 2.0)),
        joint_state(T0 + 1, ("bb", "aa"), (3.0, 4.0)),
        joint_state(T0 + 2, ("a", "bbb"), (5.0, 6.0)),
        joint_state(T0 + 3, ("aa", "bb"), (7.0, 8.0)),
    ]
    assert len({len(payload) for payload in payloads}) == 1
    found = read_topic_columns(Messages(payloads), joint_topic(), JOINT_FIELDS)
    assert found.fast == 4
    assert {part.values[1]: part.rows.tolist() for part in found.parts} == {
        ("aa", "bb"): [0, 3],
        ("bb", "aa"): [1],
        ("a", "bbb"): [2],
    }


def test_columns_ignore_padding():
    first = bytearray(joint_state(T0, ("a",), (1.0,)))
    second = bytearray(first)
    place = first.index(b"base\0") + 5
    assert first[place : place + 3] == b"\0\0\0"
    second[place : place + 3] = b"\7\7\7"
    found = read_topic_columns(Messages([bytes(first), bytes(second)]), joint_topic(), JOINT_FIELDS)
    assert (found.fast, len(found.parts)) == (2, 1)


def test_columns_fall_back_beyond_the_known_layouts():
    payloads = [joint_state(T0 + n, (f"joint{'x' * (n % 20)}",), (float(n),)) for n in range(60)]
    found = read_topic_columns(Messages(payloads, 60), joint_topic(), JOINT_FIELDS)
    assert (found.fast, found.fallback) == (24, 36)
    np.testing.assert_array_equal(found.column("position")[:, 0], np.arange(60.0))


def test_columns_keep_file_order_of_variable_arrays():
    payloads = [joint_state(T0 + n, ("a", "b")[: 1 + n % 2], (1.0 * n, -1.0)[: 1 + n % 2]) for n in range(6)]
    got = read_topic_columns(Messages(payloads), joint_topic(), ("position",)).column("position")
    np.testing.assert_array_equal(got[:, 0], np.arange(6.0))
    np.testing.assert_array_equal(np.isnan(got[:, 1]), np.arange(6) % 2 == 0)


@pytest.mark.parametrize("count", [3, 10_000, 0x7FFFFFFF, 0xFFFFFFFF])
def test_columns_refuse_a_wrong_length_before_allocation(count):
    payload = bytearray(joint_state(T0, ("a",), (1.0,)))
    place = len(payload) - 4 - 4 - 8 - 4
    place -= (place - 4) % 4
    while payload[place : place + 4] != struct.pack("<I", 1):
        place -= 4
    payload[place : place + 4] = struct.pack("<I", count)
    tracemalloc.start()
    found = read_topic_columns(Messages([bytes(payload), joint_state(T0, ("a",), (1.0,))]), joint_topic(), JOINT_FIELDS)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()
    assert dict(found.rejected) == {"malformed": 1}
    assert found.sound.tolist() == [1]


def test_columns_bound_memory_of_long_messages():
    payload = b"\0\1\0\0" + struct.pack("<I", 1 << 20) + bytes(1 << 20)
    tracemalloc.start()
    found = read_topic_columns(Messages([payload]), topic("uint8[] x"), ("x",))
    assert tracemalloc.get_traced_memory()[1] < 64 << 20
    tracemalloc.stop()
    assert found.parts[0].values[0].shape == (1, 1 << 20)


@pytest.mark.parametrize("text", ["float64[2000000000] x", "Inner[2000000000] x\n===\nMSG: test_msgs/Inner\nfloat64 a"])
def test_columns_refuse_huge_fixed_sizes_quickly(text):
    tracemalloc.start()
    found = read_topic_columns(Messages([bytes(64)]), topic(text), ("x" if "Inner" not in text else "x[:].a",))
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()
    assert dict(found.rejected) == {"malformed": 1}


def test_columns_skip_empty_structs():
    text = "Inner[2000000000] x\nuint8 y\n=====\nMSG: test_msgs/Inner\n"
    found = read_topic_columns(Messages([b"\7"]), topic(text, "ros1"), ("y",))
    assert found.column("y").tolist() == [7]


def test_columns_detect_ros1_labelled_cdr():
    types = {ROOT: (Member("f0", "uint32", ""), Member("f1", "string", ""), Member("f2", "float64", "[]"))}
    types |= {LEAF: (Member("f0", "bool", ""),), INNER: (Member("f0", "bool", ""),)}
    messages = [{"f0": n, "f1": "abc", "f2": [0.5 * n, 1.5]} for n in range(5)]
    found = read_topic_columns(Messages(encode(types, messages, "ros1")), topic(text_of(types), "cdr"), paths(types))
    check(found, messages, paths(types))


def test_columns_read_skin_cells_as_one_array():
    payloads = [_skin(cells=117, message=n) for n in range(9)]
    fields = ("data[:].prox[0]", "data[:].cellId", "data[:]{cellId==3}.ts")
    found = read_topic_columns(Messages(payloads), topic(SKIN, "ros1"), fields)
    assert (found.fast, len(found.parts)) == (9, 1)
    want = np.arange(117) / 256 + np.arange(9)[:, None]
    np.testing.assert_array_equal(found.column("data[:].prox[0]"), want)
    np.testing.assert_array_equal(found.column("data[:].cellId")[4], np.arange(117))
    np.testing.assert_array_equal(found.column("data[:]{cellId==3}.ts")[:, 0], 1000 * np.arange(9) + 3)


def _skin(cells: int, message: int, silent: int = -1) -> bytes:
    out = struct.pack("<I", cells)
    for cell in range(cells):
        prox = (message + cell / 256,) if cell != silent else ()
        out += struct.pack(f"<iqI{len(prox)}fI3f", cell, 1000 * message + cell, len(prox), *prox, 3, 1.0, 2.0, 3.0)
    return out


def test_columns_give_nan_for_a_missing_cell():
    found = read_topic_columns(Messages([_skin(4, 0, silent=1)]), topic(SKIN, "ros1"), ("data[:].prox[0]",))
    np.testing.assert_array_equal(found.column("data[:].prox[0]"), [[0, np.nan, 2 / 256, 3 / 256]])


@pytest.mark.parametrize("size", [0, 1, 2, 7, 400])
@pytest.mark.parametrize("inner", [("uint8", "float64", "uint16"), ("uint16", "uint8", "time"), ("uint8",) * 3])
def test_columns_skip_long_arrays_of_fixed_structs(size, inner):
    inner = tuple(kind.replace("time", "builtin_interfaces/Time") for kind in inner)
    types = {
        LEAF: tuple(Member(f"f{n}", kind, "") for n, kind in enumerate(inner)),
        INNER: (Member("f0", "test_msgs/Leaf", ""), Member("f1", "uint8", "[2]")),
        ROOT: (Member("f0", "test_msgs/Inner", "[]"), Member("f1", "float64", "")),
    }
    leaf = {f"f{n}": (5, 6) if "/" in kind else n for n, kind in enumerate(inner)}
    message = {"f0": [{"f0": leaf, "f1": [1, 2]}] * size, "f1": 9.5}
    found = read_topic_columns(Messages(encode(types, [message], "little")), topic(text_of(types)), ("f1",))
    assert found.column("f1").tolist() == [9.5]


def test_columns_reject_unknown_encapsulation():
    found = read_topic_columns(Messages([b"\0\3\0\0" + bytes(60)]), joint_topic(), JOINT_FIELDS)
    assert dict(found.rejected) == {"malformed": 1}


@pytest.mark.parametrize(
    ("path", "says"),
    [
        ("positions", "has no field 'positions'; it has header, name, position"),
        ("header", "is a std_msgs/msg/Header; name one of stamp, frame_id"),
        ("header.stamp[0]", "stamp is not an array"),
        ("position.x", r"write position\[:\].x"),
    ],
)
def test_columns_list_fields_for_a_missing_one(path, says):
    with pytest.raises(ConfigError, match=says):
        read_topic_columns(Messages([]), joint_topic(), (path,))


def test_decoder_lists_encodings_for_an_unknown_one():
    with pytest.raises(FormatError, match="/x: the messages are 'wrong_format'; known are cdr, ros1, json, protobuf"):
        read_topic_columns(Messages([]), topic("bool x", "wrong_format"), ("x",))
    with pytest.raises(FormatError, match="/x: the definition is 'flatbuffer'; known are ros2msg"):
        read_topic_columns(Messages([]), replace(topic("bool x"), definition_encoding="flatbuffer"), ("x",))


def test_decoder_names_the_topic_of_a_broken_definition():
    with pytest.raises(FormatError, match=r"^/x: test_msgs/msg/Root: cannot read"):
        read_topic_columns(Messages([]), topic("}{"), ("x",))


def test_columns_read_json_messages():
    stamps = [{"stamp": {"sec": 5, "nsec": n}} for n in range(3)]
    payloads = [json.dumps({"header": stamps[n], "q": [1.0 * n, 2], "name": "left"}).encode() for n in range(3)]
    found = read_topic_columns(Messages([*payloads, b"{", b"[]", b"{}"]), topic("{}", "json"), ("header.stamp", "q", "name"))
    assert found.column("header.stamp").tolist() == [5 * 10**9 + n for n in range(3)]
    np.testing.assert_array_equal(found.column("q"), [[0, 2], [1, 2], [2, 2]])
    assert (found.fast, found.fallback) == (3, 0)
    assert dict(found.rejected) == {"malformed": 2, "field missing": 1}


@pytest.mark.parametrize("batch", [1, 3])
def test_columns_reject_a_truncated_message_in_a_batch(batch):
    payloads = [joint_state(T0 + n, ("a", "b"), (1.0, 2.0)) for n in range(3)]
    place = payloads[1].index(struct.pack("<d", 2.0))
    payloads[1] = payloads[1][: place + 4]
    found = read_topic_columns(Messages(payloads, batch), joint_topic(), JOINT_FIELDS)
    assert (found.sound.tolist(), dict(found.rejected)) == ([0, 2], {"malformed": 1})


WIDE = {1: "utf-16-le", 2: "utf-16-le", 4: "utf-32-le"}


def _wide(text: str, size: int, x: float) -> bytes:
    """A message `wstring y, float64 x`, whose writer counts characters of `size` bytes, or bytes (1)."""
    data = text.encode(WIDE[size])
    body = struct.pack("<I", len(data) // size) + data
    return b"\0\1\0\0" + body + bytes(-len(body) % 8) + struct.pack("<d", x)


@pytest.mark.parametrize("size", [1, 2, 4])
def test_widened_finds_character_size_from_message_length(size):
    """The first message has no text, so it does not determine the size."""
    some = [("", 1.5), ("\N{GREEK SMALL LETTER ALPHA}bcdefghi", 2.5), ("jk", 3.5), ("lmnopq", 4.5)]
    log = Messages([_wide(text, size, x) for text, x in some])
    found = read_topic_columns(log, topic("wstring y\nfloat64 x"), ("y", "x"))
    assert found.column("x").tolist() == [1.5, 2.5, 3.5, 4.5] and not found.rejected
    assert found.column("y").ravel().tolist() == [text for text, _ in some]


def test_columns_reject_only_text_of_unknown_width():
    """Three characters of unknown size, and at least four bytes left over."""
    log, wide = Messages([b"\0\1\0\0" + struct.pack("<dI10s", 2.5, 3, b"a\0b\0c")]), topic("float64 x\nwstring y")
    assert read_topic_columns(log, wide, ("x",)).column("x").tolist() == [2.5]
    assert dict(read_topic_columns(log, wide, ("y",)).rejected) == {"malformed": 1}


@pytest.mark.parametrize("odd", [0, 511, 512, 700, 1199])
def test_columns_find_one_odd_message_in_a_large_batch(odd):
    payloads = [joint_state(T0 + n, ("aa", "bb") if n != odd else ("bb", "aa"), (1.0 * n, 0.5)) for n in range(1200)]
    found = read_topic_columns(Messages(payloads, 1200), joint_topic(), JOINT_FIELDS)
    assert {part.values[1]: len(part.rows) for part in found.parts} == {("aa", "bb"): 1199, ("bb", "aa"): 1}
    np.testing.assert_array_equal(found.column("position")[:, 0], np.arange(1200))

"""Definitions as recorders write them, and broken ones."""

import pytest
from rosbags.typesys import Stores, get_typestore

from bodylog.errors import FormatError
from bodylog.logs.decode.definitions import Field, parse_definition
from tests.work import at_most

TUM = b"""SkinCellData[] data
================================================================================
MSG: tum_ics_skin_msgs/SkinCellData
int32 cellId
int64 ts
float32[] prox
float32[] force
"""


def fields(text: str, encoding: str = "ros2msg") -> tuple[Field, ...]:
    return parse_definition(text.encode(), "p/msg/T", encoding).types["p/msg/T"]


def test_parse_reads_every_kind_of_line():
    text = """
# a remark
int32 TYPE=3           # a constant
string NAME= a # b
float64 x              # a remark
float64 y 1.5
string<=5 short "abc"
int32[<=3] few
uint8[4] four
string<=8[] many
p/Inner one
Inner[2] two
================
MSG: p/Inner
bool ok
"""
    assert fields(text) == (
        Field("x", "float64", None),
        Field("y", "float64", None),
        Field("short", "string", None),
        Field("few", "int32", -1),
        Field("four", "uint8", 4),
        Field("many", "string", -1),
        Field("one", "p/msg/Inner", None),
        Field("two", "p/msg/Inner", 2),
    )


def test_parse_reads_ros1_spellings():
    found = fields("Header header\ntime t\nduration d\nbyte b\nchar c\n", "ros1msg")
    assert [(f.name, f.type) for f in found] == [
        ("header", "std_msgs/msg/Header"),
        ("t", "time"),
        ("d", "duration"),
        ("b", "int8"),
        ("c", "char"),
    ]


def test_parse_gives_only_ros1_headers_a_sequence_number():
    ros1 = parse_definition(b"Header header\n", "p/msg/T", "ros1msg").types["std_msgs/msg/Header"]
    ros2 = parse_definition(b"std_msgs/Header header\n", "p/msg/T", "ros2msg").types["std_msgs/msg/Header"]
    assert [f.name for f in ros1] == ["seq", "stamp", "frame_id"]
    assert [f.name for f in ros2] == ["stamp", "frame_id"]


def test_parse_resolves_types_of_the_same_package():
    found = parse_definition(TUM, "tum_ics_skin_msgs/msg/SkinCellDataArray", "ros1msg")
    assert found.types[found.root] == (Field("data", "tum_ics_skin_msgs/msg/SkinCellData", -1),)


def test_parse_looks_up_standard_types():
    found = parse_definition(b"", "sensor_msgs/msg/JointState", "ros2msg")
    assert [f.name for f in found.types[found.root]] == ["header", "name", "position", "velocity", "effort"]


def test_parse_gives_empty_ros2_messages_a_byte():
    assert len(parse_definition(b"", "std_msgs/msg/Empty", "ros2msg").types["std_msgs/msg/Empty"]) == 1
    assert parse_definition(b"", "std_msgs/msg/Empty", "ros1msg").types["std_msgs/msg/Empty"] == ()


def test_parse_reads_idl():
    text = """================================================================================
IDL: p/msg/T
#include "p/msg/Inner.idl"
module p { module msg {
  typedef double double__3[3];
  struct T {
    int32 count; sequence<double> many; sequence<float, 4> few;
    double__3 three; string name; p::msg::Inner in;
  };
}; };
================================================================================
IDL: p/msg/Inner
module p { module msg { struct Inner { boolean ok; octet raw; }; }; };
"""
    found = parse_definition(text.encode(), "p/msg/T", "ros2idl")
    sizes = [(f.name, f.type, f.size) for f in found.types["p/msg/T"]]
    assert sizes == [
        ("count", "int32", None),
        ("many", "float64", -1),
        ("few", "float32", -1),
        ("three", "float64", 3),
        ("name", "string", None),
        ("in", "p/msg/Inner", None),
    ]
    assert [f.type for f in found.types["p/msg/Inner"]] == ["bool", "byte"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("float64", "cannot read the definition line"),
        ("}{ garbage", "cannot read the definition line"),
        ("unknown_msgs/Thing x", "no definition of unknown_msgs/msg/Thing"),
        ("T again", "contains itself"),
        ("float64[99999999999999999999] x", "asks for"),
        ("float64[4294967296] x", "asks for"),
        ("\n".join(["A a", "=" * 9, "MSG: p/A", "B b", "=" * 9, "MSG: p/B", "A a"]), "contains itself"),
    ],
)
def test_parse_names_what_it_cannot_read(text, says):
    with pytest.raises(FormatError, match=says):
        fields(text)


def test_parse_refuses_bytes_that_are_not_text():
    with pytest.raises(FormatError, match="not text"):
        parse_definition(b"\xff\xfe\x00", "p/msg/T", "ros2msg")


def test_parse_is_fast_for_doubling_definitions():
    levels = [f"MSG: p/L{n}\nL{n + 1} a\nL{n + 1} b\n" for n in range(40)]
    text = ("=" * 9 + "\n").join(["L0 x\n", *levels, "MSG: p/L40\n"])
    with at_most(calls=50_000):
        assert len(parse_definition(text.encode(), "p/msg/T", "ros1msg").types) == 42


@pytest.mark.parametrize("version", [1, 2])
def test_parse_agrees_with_rosbags_on_standard_types(version):
    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    dialect = f"ros{version}msg"
    for name in sorted(store.fielddefs):
        if name in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"):
            continue
        text = store.generate_msgdef(name, ros_version=version)[0]
        found = parse_definition(text.encode(), name, dialect)
        dummy = "structure_needs_at_least_one_member"
        labels = [label for label, _ in store.fielddefs[name][1] if version == 2 or label != dummy]
        assert [f.name for f in found.types[name]] == labels, name

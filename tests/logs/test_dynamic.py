"""JSON and protobuf messages as columns, and broken ones."""

import json
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bodylog.errors import FormatError
from bodylog.logs.decode.columns import read_topic_columns
from bodylog.recording.clocks import stamp_field
from tests.logs.memory_logs import SCHEMA, STATE, Messages, topic

from .writing import wire


def state(n: int) -> bytes:
    joints = b"".join(wire(2, wire(1, name) + b"\x11" + struct.pack("<d", n + k)) for k, name in ((0, b"a"), (1, b"b")))
    numbers = wire(3, (struct.pack("<f", 0.5 * n),)) + wire(4, 2 * n + 1) + wire(5, (1 << 64) - 7)
    packed = wire(6, struct.pack("<3d", n, 1, 2)) + wire(7, b"\x05\x80\x02") + wire(7, 9)
    stamp, wide = wire(1, wire(1, 5) + wire(2, n)), b"\x49" + struct.pack("<q", -n)
    return stamp + joints + numbers + packed + wire(8, b"abc") + wide


KEYS = ("q", "header", "stamp", "sec")


def test_reader_reads_every_protobuf_kind():
    fields = (
        "timestamp", "joints[:].angle", "joints[:].name", "temperature", "offset", "level", "packed_values", "counts",
        "label", "wide", "joints[:]{name==\"b\"}.angle", "joints[-1].angle",
    )  # fmt: skip
    got = read_topic_columns(Messages([state(n) for n in range(3)]), STATE, fields)
    assert (got.fallback, dict(got.rejected)) == (3, {})
    assert got.column("timestamp").tolist() == [5 * 10**9 + n for n in range(3)]
    assert got.column("joints[:].angle").tolist() == [[n, n + 1] for n in range(3)]
    assert got.parts[0].values[2] == ("a", "b")
    assert got.column("temperature").tolist() == [0, 0.5, 1]
    assert got.column("offset").tolist() == [-1, -2, -3]
    assert got.column("level").tolist() == [-7] * 3
    assert got.column("packed_values").tolist() == [[n, 1, 2] for n in range(3)]
    assert got.column("counts").tolist() == [[5, 256, 9]] * 3
    assert got.column("wide").tolist() == [0, -1, -2]
    assert got.column('joints[:]{name=="b"}.angle').tolist() == [[n + 1] for n in range(3)]
    assert got.column("joints[-1].angle").tolist() == [n + 1 for n in range(3)]


def test_reader_gives_defaults_for_absent_protobuf_numbers():
    got = read_topic_columns(Messages([b""]), STATE, ("temperature", "label"))
    assert (got.column("temperature").tolist(), got.parts[0].values[1]) == ([0], ("",))
    got = read_topic_columns(Messages([b""]), STATE, ("timestamp.seconds",))
    assert dict(got.rejected) == {"field missing": 1}


@pytest.mark.parametrize(
    ("definition", "type_", "says"),
    [
        (b"\xff\xff\xff", "robot.State", "not a FileDescriptorSet"),
        (b"", "robot.State", "defines no robot.State"),
        (SCHEMA, "robot.Sate", "defines no robot.Sate; it has google.protobuf.Timestamp, robot.Joint, robot.State"),
    ],
)
def test_reader_refuses_broken_schemas(definition, type_, says):
    with pytest.raises(FormatError, match=says):
        read_topic_columns(Messages([]), topic(definition, "protobuf", type_), ("label",))


def test_stamp_field_reads_schemas():
    assert stamp_field(STATE) == "timestamp"
    assert stamp_field(topic(SCHEMA, "protobuf", "robot.Joint")) is None
    schema = {"properties": {"header": {"type": "object"}, "q": {"type": "array"}}}
    assert stamp_field(topic(json.dumps(schema).encode(), "json", "x")) == "header.stamp"
    assert stamp_field(topic(b'{"properties": {"timestamp": {}}}', "json", "x")) == "timestamp"
    assert stamp_field(topic(b"", "json", "x")) is None
    assert stamp_field(topic(b"[1", "json", "x")) is None


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(flips=st.lists(st.tuples(st.integers(0, 300), st.integers(1, 255)), max_size=4), cut=st.integers(0, 200))
def test_columns_count_damaged_protobuf(flips, cut):
    broken = bytearray(state(3)[:cut])
    for where, bits in flips if broken else ():
        broken[where % len(broken)] ^= bits
    got = read_topic_columns(Messages([bytes(broken)]), STATE, ("timestamp", "joints[:].angle", "counts", "label"))
    assert len(got.sound) + sum(got.rejected.values()) == 1


def test_columns_reject_deeply_nested_json():
    deep = b'{"q": ' + b"[" * 900 + b"]" * 900 + b"}"
    got = read_topic_columns(Messages([deep, b'{"q": [1]}']), topic(b"", "json", "x"), ("q",))
    assert len(got.sound) + sum(got.rejected.values()) == 2


def test_columns_turn_huge_integers_into_floats():
    got = read_topic_columns(Messages([b'{"q": [1, 1000000000000000000000]}']), topic(b"", "json", "x"), ("q",))
    assert got.column("q").tolist() == [[1, 1e21]]


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(payload=st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(KEYS), inner),
    max_leaves=12,
))  # fmt: skip
def test_columns_survive_any_json(payload):
    got = read_topic_columns(Messages([json.dumps(payload).encode()]), topic(b"", "json", "x"), ("header.stamp", "q", "q[0]"))
    assert len(got.sound) + sum(got.rejected.values()) == 1
    np.testing.assert_array_equal(got.sound, np.arange(len(got.sound)))

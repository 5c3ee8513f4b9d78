"""JSON members alone, and protobuf messages of equal layout at once: the same values as whole messages one by one."""

import json
import random
import struct

import numpy as np
import pytest

from bodylog.logs.decode import dynamic
from bodylog.logs.decode.columns import read_topic_columns
from tests.logs.memory_logs import STATE, Messages, topic

from .writing import wire

JSON = topic(b"", "json", "x")
FIELDS = ("header.stamp", "header.frame_id", "name", "position", "position[1]", "on", "count", "gone", "deep[:].x",
          'deep[:]{id==2}.x', 'deep[:]{name=="a1"}.x', "big", "big2.x")  # fmt: skip


def column_by_column(messages, of, fields):
    found = {}
    for field in fields:
        got = read_topic_columns(Messages(messages, 500), of, (field,))
        values = got.column(field)
        found[field] = (got.sound.tolist(), values.dtype.kind, values.tolist(), dict(got.rejected))
    return found


def assert_the_same(messages, of, fields, monkeypatch, least=0):
    fast = read_topic_columns(Messages(messages, 500), of, (fields[0],)).fast
    together = column_by_column(messages, of, fields)
    with monkeypatch.context() as slowly:
        slowly.setattr(dynamic, "_FEW", 1 << 60)
        slowly.setattr(dynamic.JsonBatchDecoder, "take", lambda self, batch: iter(()))
        alone = column_by_column(messages, of, fields)
    for field in fields:
        assert repr(together[field]) == repr(alone[field]), field
    assert fast >= least


def number(draw):
    return draw.choice([
        lambda: draw.gauss(0, 1), lambda: draw.gauss(0, 1e-7), lambda: draw.gauss(0, 1e30), lambda: 0, lambda: -0.0,
        lambda: draw.randrange(-9, 10**6), lambda: 5.0,
    ])()  # fmt: skip


def state(draw, count):
    stamp = {"sec": draw.randrange(10**10), "nanosec": draw.randrange(10**9)}
    deep = [{"id": draw.randrange(4), "name": draw.choice(["a1", "a2", "b"]), "x": number(draw)} for _ in range(2)]
    return {
        "header": {"stamp": stamp, "frame_id": draw.choice(["base", "tool-1e-5", 'é\\ "7"', "12", "2", "2/1e+5", "+"])},
        "name": ["j_1", "j_2"],
        "position": [number(draw) for _ in range(count)],
        "on": draw.random() < 0.5,
        "count": draw.choice([1, 2.5, None, 10**30, (1 << 63) - 1, -(1 << 63), float("nan")]),
        **({"gone": draw.randrange(5)} if draw.random() < 0.5 else {}),
        "deep": deep,
        "big": draw.randrange(10**17, 10**19),
        "big2": {"x": draw.choice(["", "1", 1])},
        "key-1e-2": f"frame_{draw.randrange(1000)}",
    }


@pytest.mark.parametrize("seed", range(8))
def test_json_decoder_equals_single_decoding(seed, monkeypatch):
    draw = random.Random(seed)
    plain = seed % 2
    separators = draw.choice([None, (",", ":"), (" ,\n", ": ")])
    some = []
    for _ in range(120):
        message = state(draw, 3)
        if plain:  # else nearly every message has its own skeleton
            message |= {"on": True, "count": 7, "gone": 1, "big2": {"x": 1}}
            message["header"]["frame_id"] = draw.choice(["base", "2"])
            message["deep"][0]["name"], message["deep"][1]["name"] = "a1", draw.choice(["a2", "a1"])
        some.append(json.dumps(message, separators=separators).encode())
    assert_the_same(some, JSON, FIELDS, monkeypatch, least=60 if plain else 0)


MALFORMED = ("+1", "01", "-01", "1.", ".5", "-.5", "1.e5", "1e", "1e-", "--1", "1-2", "1.2.3", "1e5e5", "1e-5.2", "-",
             "1e-05", "-0", "1E+3", "1E3", "0e-0", "9223372036854775808", "1e-999", "1e+999")  # fmt: skip


@pytest.mark.parametrize("written", MALFORMED)
def test_json_decoder_rejects_invalid_numbers(written, monkeypatch):
    sound = [f'{{"q": [{k}.5, 2.25], "x": 1}}'.encode() for k in range(20)]
    odd = [f'{{"q": [{written}, 2.25], "x": 1}}'.encode() for _ in range(8)]
    assert_the_same([*sound, *odd, *sound], JSON, ("q", "q[0]", "q[0:0]"), monkeypatch, least=0)


def test_json_decoder_ignores_digits_in_texts(monkeypatch):
    some = [b'{"s": "12", "x": 5, "t": ""}', b'{"s": "", "x": 5, "t": "12"}'] * 20
    assert_the_same(some, JSON, ("x", "s", "t"), monkeypatch)


@pytest.mark.parametrize("text", [r"a\/1", "1/2", "/12", "1e+2", "e+12", "+", "1e/2"])
def test_json_decoder_reads_slashes_and_signs_in_texts(text, monkeypatch):
    sound = [f'{{"x": {x}, "t": "{text}"}}'.encode() for x in ("15.5", "-1e+05", "2.5e-07")] * 6
    assert_the_same(sound, JSON, ("x", "t"), monkeypatch, least=18)
    odd = [f'{{"x": {x}, "t": "{text}"}}'.encode() for x in ("1/5", "+15", "1+5", "1/e+5")] * 6
    assert_the_same([*sound, *odd], JSON, ("x",), monkeypatch)


def test_json_decoder_rejects_two_numbers_without_a_comma(monkeypatch):
    many = ", ".join(str(k) for k in range(30))
    assert_the_same([f'{{"q": [0, 1-2, 3], "r": [{many}]}}'.encode()] * 6, JSON, ("q",), monkeypatch)


def test_json_decoder_rejects_digits_around_messages(monkeypatch):
    for odd in (b"15", b'{"x": 15}1', b'1{"x": 15}'):
        assert_the_same([*[b'{"x": 15}'] * 6, odd, *[b'{"x": 15}'] * 6], JSON, ("x",), monkeypatch)
        assert_the_same([odd] * 6, JSON, ("x",), monkeypatch)


def test_json_decoder_handles_forbidden_bytes(monkeypatch):
    some = [b'{"x": 1\x01-5}'] * 20 + [b'{"x": 1e-5}'] * 20
    assert_the_same(some, JSON, ("x",), monkeypatch)


def test_json_decoder_reads_other_encodings(monkeypatch):
    some = [json.dumps({"x": k, "y": 1}).encode("utf-16") for k in range(100, 120)]
    assert_the_same(some, JSON, ("x",), monkeypatch)


def proto(draw):
    stamp = wire(1, draw.randrange(10**9)) + wire(2, draw.randrange(1, 10**9))
    if draw.random() < 0.1:
        stamp = stamp[:-1] + bytes([stamp[-1] | 0x80]) if draw.random() < 0.5 else b""
    out = wire(1, stamp)
    for _ in range(draw.choice((2, 2, 2, 0, 1))):
        angle = b"\x11" + struct.pack("<d", number(draw))
        name = wire(1, draw.choice([b"a", b"b", "é".encode(), b"\xff"]))
        out += wire(2, name + angle * (draw.random() < 0.9))
    if draw.random() < 0.9:
        out += wire(3, (struct.pack("<f", draw.gauss(0, 1)),))
    out += wire(4, draw.choice([1, 2, 3, 300, (1 << 64) - 1, (1 << 64) - 2]))
    out += wire(5, draw.choice([5, (1 << 64) - 7, 1 << 31, (1 << 63) + 5]))
    out += wire(6, struct.pack("<3d", *(draw.gauss(0, 1) for _ in range(3))))
    out += wire(7, b"\x05\x80\x02") + wire(7, draw.randrange(200)) if draw.random() < 0.5 else wire(7, 1 << 63)
    out += wire(8, draw.choice([b"abc", b"abd", b"\xff\xff\xff"])) + b"\x49" + struct.pack("<q", draw.randrange(-9, 9))
    return out + (wire(99, draw.randrange(5)) if draw.random() < 0.5 else b"")


@pytest.mark.parametrize("seed", range(6))
def test_protobuf_decoder_equals_single_decoding(seed, monkeypatch):
    draw = random.Random(seed)
    fields = ("timestamp", "timestamp.nanos", "joints[:].angle", "joints[:].name", "temperature", "offset", "level",
              "packed_values", "packed_values[1]", "counts", "label", "wide", 'joints[:]{name=="b"}.angle')  # fmt: skip
    some = [proto(draw) for _ in range(12)]
    many = [draw.choice(some) for _ in range(150)]
    many = [one[:-2] + bytes([draw.randrange(256), 0]) if draw.random() < 0.05 else one for one in many]
    assert_the_same(many, STATE, fields, monkeypatch, least=10)


def test_decoders_read_equal_layouts_together():
    some = [json.dumps({"q": [k / 7, -k / 3e7], "t": "x"}).encode() for k in range(1, 200)]
    got = read_topic_columns(Messages(some, 500), JSON, ("q",))
    assert (got.fast, got.fallback) == (199, 0)
    assert np.array_equal(got.column("q"), [[k / 7, -k / 3e7] for k in range(1, 200)])


def test_json_decoder_takes_an_empty_object_for_a_missing_value(monkeypatch):
    some = [b'{"x": {}}'] * 6 + [b'{"x": 1.5}'] * 6
    assert_the_same(some, JSON, ("x",), monkeypatch)
    assert_the_same(some[:6], JSON, ("x",), monkeypatch)

import numpy as np
import pytest

from bodylog.errors import FormatError
from bodylog.logs.decode.ros1_to_cdr import make_cdr_converter
from bodylog.types import Topic
from tests.logs.ros1_messages import CUSTOM, KINDS, ros1_store, values

CUSTOM_TOPIC = Topic(0, "/t", KINDS[2], "ros1", CUSTOM.encode(), "ros1msg", 0)


def messages(i, count, seed):
    """ROS 1 payloads of the custom type with the same layout and different values."""
    store, found = ros1_store(), []
    for row in range(count):
        *_, message = values(store, np.random.default_rng(seed + row), i)
        found.append(bytes(store.serialize_ros1(message, KINDS[2])))
    return np.array([np.frombuffer(payload, np.uint8) for payload in found])


@pytest.mark.parametrize("i", range(8))
def test_convert_same_layout_equals_single_conversion(i):
    convert, _ = make_cdr_converter(CUSTOM_TOPIC)
    rows = messages(i, 20, 100 * i)
    same, out = convert.convert_same_layout(rows)
    assert same.all() and [row.tobytes() for row in out] == [bytes(convert(memoryview(row.tobytes()))) for row in rows]


def test_convert_same_layout_skips_other_layouts():
    convert, _ = make_cdr_converter(CUSTOM_TOPIC)
    rows = messages(6, 20, 0)
    other = rows.copy()
    text = rows[0].tobytes().index(b"j0")
    other[::2, text] = ord("k")
    same, out = convert.convert_same_layout(other[1:])
    assert same.tolist() == [True, False] * 9 + [True] and len(out) == 10
    assert [row.tobytes() for row in out] == [bytes(convert(memoryview(row.tobytes()))) for row in other[1::2]]


def test_convert_same_layout_ignores_sequence_numbers():
    convert, _ = make_cdr_converter(CUSTOM_TOPIC)
    rows = messages(3, 5, 0)
    rows[:, :4] = np.arange(20).reshape(5, 4)
    assert convert.convert_same_layout(rows)[0].all()


@pytest.mark.parametrize("damage", [lambda r: r[:, :-1], lambda r: np.where(np.arange(r.shape[1]) == 13, 255, r)])
def test_convert_same_layout_refuses_a_broken_first_row(damage):
    convert, _ = make_cdr_converter(CUSTOM_TOPIC)
    with pytest.raises(FormatError):
        convert.convert_same_layout(np.ascontiguousarray(damage(messages(2, 3, 0))).astype(np.uint8))

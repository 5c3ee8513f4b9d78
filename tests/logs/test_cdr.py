import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bodylog.logs.encode import cdr

VALUES = {
    **{name: (name, None) for name in cdr.PRIMITIVES if name != "bool"},
    **{f"{name}[]": (name, "sequence") for name in ("uint8", "int32", "float32", "float64", "uint16")},
    **{f"{name}*": (name, "array") for name in ("uint8", "int64", "float32")},
}
NUMBERS = {name: np.dtype(code) for name, code in cdr.PRIMITIVES.items()}


def column(rng, kind, count, width):
    base, shape = VALUES[kind]
    size = (count,) if shape is None else (count, width)
    raw = rng.integers(0, 256, (*size, NUMBERS[base].itemsize), dtype=np.uint8)
    values = raw.view(NUMBERS[base])[..., 0]
    return np.nan_to_num(values) if NUMBERS[base].kind == "f" else values


def declared(kind, width):
    return kind.replace("*", f"[{width}]")


@settings(max_examples=60, deadline=None)
@given(
    kinds=st.lists(st.sampled_from([*VALUES, "string", "string[]"]), min_size=1, max_size=8),
    seed=st.integers(0, 2**32 - 1),
    width=st.integers(0, 5),
    texts=st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9), max_size=3),
)
def test_serialise_equals_rosbags(kinds, seed, width, texts):
    rng, count = np.random.default_rng(seed), 3
    widths = [max(width, 1) if kind.endswith("*") else width for kind in kinds]
    store = get_typestore(Stores.EMPTY)
    text = "".join(f"{declared(k, w)} f{i}\n" for i, (k, w) in enumerate(zip(kinds, widths, strict=True)))
    store.register(get_types_from_msg(text, "some_msgs/msg/Some"))
    fields = []
    for kind, size in zip(kinds, widths, strict=True):
        if kind in VALUES:
            fields.append((kind, column(rng, kind, count, size)))
        else:
            fields.append((kind, tuple(texts) if kind == "string[]" else "".join(texts)))
    ours = cdr.serialise_messages(count, fields)
    for i in range(count):
        values = [v[i] if isinstance(v, np.ndarray) else list(v) if isinstance(v, tuple) else v for _, v in fields]
        theirs = store.serialize_cdr(store.types["some_msgs/msg/Some"](*values), "some_msgs/msg/Some")
        assert ours.data[ours.offset[i] :][: ours.length[i]].tobytes() == bytes(theirs)


def test_merge_keeps_message_order():
    odd = cdr.serialise_messages(2, [("uint8", np.array([1, 3]))])
    even = cdr.serialise_messages(2, [("uint32", np.array([0, 2]))])
    merged = cdr.merge_payloads([(np.array([1, 3]), odd), (np.array([0, 2]), even)], 4)
    payloads = [merged.data[o : o + n].tobytes()[4:] for o, n in zip(merged.offset, merged.length, strict=True)]
    assert payloads == [b"\0\0\0\0", b"\1", b"\2\0\0\0", b"\3"]


@pytest.mark.parametrize("ns", [0, 999_999_999, 1_700_000_000_000_000_001, 2**31 * 10**9 - 1])
def test_time_splits_seconds_and_nanoseconds(ns):
    payload = cdr.serialise_messages(1, cdr.cdr_time_field(np.array([ns]))).data[4:].tobytes()
    assert int.from_bytes(payload[:4], "little") * 10**9 + int.from_bytes(payload[4:], "little") == ns


def test_serialise_writes_a_signalling_nan_without_warning():
    signalling = np.array([0x7FF0000000000001], np.uint64).view(np.float64)
    made = cdr.serialise_messages(1, [("float32", signalling)])
    assert np.isnan(made.data[-4:].view(np.float32)[0])

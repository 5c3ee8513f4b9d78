"""Numbers parsed all at once equal json.loads bit for bit."""

import json
import struct

import numpy as np
import pytest

from bodylog.logs.decode import decimals

POINTED = ("0.1", "-0.0", "123.456", "99999999.5", "123456789.25", "0.30000000000000004", "9007199254740993.0",
           "0.000000000000000000000001", "1e-05", "-2.5e-07", "1e-7", "5e-324", "1e+22", "1.7976931348623157e+308",
           "1.00000000000000011102230246251565", "12345678901234567890.5", "0.5e-00",
           "8000000000000000001.0")  # fmt: skip
WHOLE = ("0", "7", "-12", "1700000000", "123456789", "9223372036854775807", "-9223372036854775808")
INVALID = ("01", "-", "1.", ".5", "1.2.3", "1-2", "00.5", "1e-", "1.5e-1.", "+1", "--1", "1e+5-", "1e--5", "1e-+5")


def _parsed(texts):
    content, starts, ends = b'{"numbers after a key of some length":  [', [], []
    for text in texts:
        starts.append(len(content))
        content += text.encode().replace(b"e", decimals.POWER)
        ends.append(len(content))
        content += b", "
    return decimals.numbers(content + b"]          }", np.array(starts), np.array(ends))


def _assert_equal_to_json(texts):
    expected, found = np.array(json.loads(f"[{','.join(texts)}]")), _parsed(texts)
    assert found.dtype == expected.dtype
    wrong = np.flatnonzero(found.view(np.int64) != expected.view(np.int64))
    assert not len(wrong), [(texts[k], found[k]) for k in wrong[:5]]


def _spelled(rng, count):
    """Floats of any size by their bits, of the size of angles, with 1 to 17 digits, and ties between two floats."""
    anything = rng.integers(0, 2**64, count, dtype=np.uint64, endpoint=False).view(float)
    anything = anything[np.isfinite(anything)].tolist()
    angles = (rng.normal(size=count) * 10.0 ** rng.integers(-8, 8, count)).tolist()
    yield from map(repr, (*anything, *angles))
    for value, digits in zip(angles, rng.integers(1, 18, count).tolist(), strict=True):
        yield f"{value:.{digits}f}"
        yield f"{value:.{digits}e}"
        yield repr(float(f"{value:.{digits}g}"))
    for even in (rng.integers(2**52, 2**53, count // 8)).tolist():
        yield f"{(2 * even + 1) / 2**3:.3f}"
        yield f"{2 * even + 1}.0"


@pytest.mark.parametrize("seed", range(4))
def test_floats_are_those_of_json_bit_for_bit(seed):
    _assert_equal_to_json(list(_spelled(np.random.default_rng(seed), 4000)))


def test_most_floats_of_full_precision_are_not_read_one_by_one(monkeypatch):
    counts = []
    one_by_one = decimals._one_by_one
    monkeypatch.setattr(decimals, "_one_by_one", lambda text, *at: counts.append(len(at[0])) or one_by_one(text, *at))
    _assert_equal_to_json([repr(value) for value in np.random.default_rng(5).normal(size=10_000).tolist()])
    assert sum(counts) < 100


@pytest.mark.parametrize("text", POINTED)
def test_each_kind_of_float_alone_and_among_others(text):
    _assert_equal_to_json([text])
    _assert_equal_to_json(["0.25", text, "3", "-1e-05"])


def test_whole_numbers_stay_whole():
    for text in WHOLE:
        _assert_equal_to_json([text])
        _assert_equal_to_json([text, "0.5"])
    _assert_equal_to_json(list(WHOLE))
    _assert_equal_to_json(["-0", "0.5", "0"])
    _assert_equal_to_json(["-0", "1"])
    rng = np.random.default_rng(3)
    _assert_equal_to_json([str(int(n) >> k % 63) for k, n in enumerate(rng.integers(-(2**63), 2**63, 999))])
    assert _parsed(["9223372036854775808"]) is None and _parsed(["1", str(2**70)]) is None
    assert _parsed([str(9 * 10**26 + 1), "0.5"]) is None


@pytest.mark.parametrize("text", INVALID)
def test_what_is_no_json_number_is_not_read(text):
    with pytest.raises(ValueError):
        json.loads(text)
    assert _parsed([text]) is None and _parsed(["0.5", text]) is None and _parsed([text, "17"]) is None


def test_a_number_at_the_beginning_is_read():
    content = b"[-0.12345678901234567]       "
    found = decimals.numbers(content, np.array([1]), np.array([21]))
    assert struct.pack("d", *found) == struct.pack("d", -0.12345678901234567)

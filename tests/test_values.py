"""What a file says, checked where it enters."""

import json

import numpy as np
import pytest

from bodylog.io import values


@pytest.mark.parametrize(
    ("ns", "want"),
    [(5, 5), (values.LATEST_NS, values.LATEST_NS), (-1, 0), (values.LATEST_NS + 1, 0), (-(2**63), 0), (2**63 - 1, 0)],
)
def test_times_no_clock_shows_become_zero(ns, want):
    assert values.times(np.array([7, ns])).tolist() == [7, want]


def test_unsigned_times_beyond_63_bits_become_zero():
    assert values.times(np.array([1, 2**63, 2**64 - 1], np.uint64)).tolist() == [1, 0, 0]


@pytest.mark.parametrize(
    ("seconds", "rest", "want"),
    [
        (1, 5, 1_000_000_005), (-1, 0, -1_000_000_000), ("12", "3", 12_000_000_003), (float("inf"), 0, 0),
        (1e30, 0, 0), (10**401, 0, 0), (0, 10**30, 0), (2**63, 0, 0),
    ],
)  # fmt: skip
def test_stamps_beyond_the_clock_are_zero(seconds, rest, want):
    assert values.nanoseconds(seconds, rest) == want


@pytest.mark.parametrize("value", [1, -5, 2.5, 2**63 - 1, -(2**63), True])
def test_numbers_of_64_bits_stay(value):
    assert values.number(value) == value


def test_larger_numbers_become_floats_or_none():
    assert values.number(2**64) == 2.0**64
    assert np.isnan(values.number(10**401))


@pytest.mark.parametrize("said", ["", "plain", "ünï", "🤖"])
def test_sound_texts_stay(said):
    assert values.text(said) == said


def test_half_a_surrogate_pair_is_written_as_its_escape():
    assert values.text("a\ud800b").encode() == b"a\\ud800b"


def _nested(depth):
    return "[" * depth + "]" * depth


def test_json_is_read_to_a_depth_that_recursion_bears():
    assert values.read_json(b'{"a": [1, 2]}') == {"a": [1, 2]}
    assert values.read_json(_nested(values.DEEPEST)) is not None
    wide = json.dumps([[k] for k in range(1000)])
    assert len(values.read_json(wide)) == 1000


@pytest.mark.parametrize("depth", [values.DEEPEST + 2, 900, 100_000])
def test_deeper_json_is_refused(depth):
    with pytest.raises(ValueError, match="nested"):
        values.read_json(_nested(depth))

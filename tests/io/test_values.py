"""Validation of values from files."""

import json

import numpy as np
import pytest

from bodylog.io import values


@pytest.mark.parametrize(
    ("ns", "want"),
    [(5, 5), (values.LATEST_NS, values.LATEST_NS), (-1, 0), (values.LATEST_NS + 1, 0), (-(2**63), 0), (2**63 - 1, 0)],
)
def test_times_out_of_range_become_zero(ns, want):
    assert values.log_times_ns(np.array([7, ns])).tolist() == [7, want]


def test_times_beyond_63_bits_become_zero():
    assert values.log_times_ns(np.array([1, 2**63, 2**64 - 1], np.uint64)).tolist() == [1, 0, 0]


@pytest.mark.parametrize(
    ("seconds", "rest", "want"),
    [
        (1, 5, 1_000_000_005), (-1, 0, -1_000_000_000), ("12", "3", 12_000_000_003), (float("inf"), 0, 0),
        (1e30, 0, 0), (10**401, 0, 0), (0, 10**30, 0), (2**63, 0, 0),
    ],
)  # fmt: skip
def test_nanoseconds_out_of_range_are_zero(seconds, rest, want):
    assert values.stamp_ns(seconds, rest) == want


@pytest.mark.parametrize("value", [1, -5, 2.5, 2**63 - 1, -(2**63), True])
def test_number_keeps_64_bits(value):
    assert values.number_in_64_bits(value) == value


def test_number_turns_larger_ones_into_floats_or_nan():
    assert values.number_in_64_bits(2**64) == 2.0**64
    assert np.isnan(values.number_in_64_bits(10**401))


@pytest.mark.parametrize("value", ["", "plain", "ünï", "🤖"])
def test_text_keeps_valid_strings(value):
    assert values.encodable_text(value) == value


def test_text_escapes_lone_surrogates():
    assert values.encodable_text("a\ud800b").encode() == b"a\\ud800b"


def _nested(depth):
    return "[" * depth + "]" * depth


def test_read_json_reads_up_to_the_depth_limit():
    assert values.read_json(b'{"a": [1, 2]}') == {"a": [1, 2]}
    assert values.read_json(_nested(values.DEEPEST)) is not None
    wide = json.dumps([[k] for k in range(1000)])
    assert len(values.read_json(wide)) == 1000


@pytest.mark.parametrize("depth", [values.DEEPEST + 2, 900, 100_000])
def test_read_json_refuses_deeper_values(depth):
    with pytest.raises(ValueError, match="nested"):
        values.read_json(_nested(depth))

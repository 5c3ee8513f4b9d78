"""Claims are judged over seeds."""

import math

import pytest

from bodylog.experiments.records import Bound, column, judge, panel

LOW, HIGH, NAN = [0.1] * 10, [2.0] * 10, [float("nan")] * 10


def verdict(printed, ours, bound=None):
    return judge("E0", "", "", "1", bound or Bound("≤", 1.0), (printed, ours)).verdict


def test_verdicts():
    assert verdict(LOW, HIGH) == "confirmed"
    assert verdict(HIGH, LOW) == "corrected"
    assert verdict(HIGH, HIGH) == "refuted"
    assert verdict(HIGH, LOW, Bound("≥", 1.0)) == "confirmed"


@pytest.mark.parametrize(("wrong", "expected"), [(1, "confirmed"), (2, "refuted")])
def test_nine_of_ten_seeds_must_hold(wrong, expected):
    assert verdict(LOW[wrong:] + HIGH[:wrong], HIGH) == expected


def test_a_belief_that_diverged_never_holds():
    assert verdict(NAN, NAN) == "refuted"
    assert verdict(NAN, NAN, Bound("≥", 0.0)) == "refuted"
    assert math.isnan(judge("E0", "", "", "1", Bound("≤", 1.0), (NAN, LOW)).spread["printed"][0])


def test_null_reads_as_not_a_number():
    found = column([{"figures": {"a": None}}, {"figures": {"a": 2}}], "a")
    assert math.isnan(found[0]) and found[1] == 2.0


def test_a_panel_keeps_both_ends():
    shown = panel("", "", range(1000), {"a": range(1000)}, most=10)
    assert len(shown["t"]) == 10 and shown["t"][0] == 0 and shown["lines"]["a"][-1] == 999

"""Claims are judged in every reading, over seeds, with controls."""

import math

import pytest

from bodylog.experiments.claims import Bound, Control, Counts
from bodylog.experiments.judging import (
    judge_comparison,
    judge_own_claim,
    judge_paper_claim,
    judge_variants,
    median_interval,
    untestable_claim,
)

LOW, HIGH, NAN = (0.1,) * 10, (2.0,) * 10, (float("nan"),) * 10


def judged(found, swept=(), controls=()):
    return judge_paper_claim(
        "E0.1",
        "",
        "",
        "1",
        Bound("≤", 1.0),
        "it",
        lambda key, name: found[key, name],
        _keys(found, swept),
        swept,
        controls,
    )


def _keys(found, swept):
    return [key for key, name in found if name == "it" and key not in {row[2] for row in swept}]


def named(**by):
    return {(key.replace("__", "=").replace("_AND_", ","), "it"): value for key, value in by.items()}


def test_judged_gives_each_verdict():
    assert judged(named(centre=LOW, sigma_n__noise=LOW)).verdict == "kept"
    assert judged(named(centre=LOW, sigma_n__noise=HIGH, mu_x__zero=LOW)).verdict == "depends on σ_n"
    assert judged(named(centre=HIGH, sigma_n__noise=HIGH, mu_x__zero=NAN)).verdict == "refuted"
    assert judged(named(centre=NAN, sigma_n__noise=NAN)).verdict == "not tested"
    assert untestable_claim("E0.1", "", "why").verdict == "not testable here"


def test_a_reading_that_diverges_tests_no_claim():
    claim = judged(named(centre=LOW, sigma_v__pixels=NAN, sigma_n__noise=LOW))
    assert claim.verdict == "kept" and claim.counts == Counts(2, 0, 1)
    assert claim.reasons == ("not tested at sigma_v=pixels: the model diverged, in 10 of 10 seeds",)
    few = judged(named(centre=LOW[:9] + NAN[:1]))
    assert few.counts == Counts(1, 0, 0), "nine of ten seeds test it"
    assert judged(named(centre=LOW[:8] + NAN[:2])).counts == Counts(0, 0, 1)


def test_infinity_refutes_and_does_not_diverge():
    never = (float("inf"),) * 10
    claim = judged(named(centre=never))
    assert claim.verdict == "refuted" and claim.reasons == ("refuted at centre: inf, kept by 0 of 10 seeds",)


def test_judged_names_all_constants_that_jointly_change_it():
    found = {("centre", "it"): LOW, ("sigma_v=widths", "it"): LOW, ("sigma_n=noise,sigma_v=widths", "it"): HIGH}
    assert judged(found).verdict == "depends on σ_n, σ_v"
    alone = {**found, ("sigma_v=widths", "it"): HIGH}
    assert judged(alone).verdict == "depends on σ_v"


def test_judged_gives_turning_points_only_of_decisive_sweeps():
    found = named(centre=LOW, speed__4=HIGH, speed__30=LOW, noise__0=LOW) | {("speed=10", "it"): HIGH}
    swept = [
        ("speed", 4.0, "speed=4"),
        ("speed", 10.0, "speed=10"),
        ("speed", 30.0, "speed=30"),
        ("noise", 0.1, "noise=0"),
    ]
    tried = ["centre", "speed=4"]
    claim = judge_paper_claim("E0.1", "", "", "1", Bound("≤", 1.0), "it", lambda key, name: found[key, name], tried, swept)
    assert claim.turns == "T: between 10 and 30 (period in s)"
    assert list(claim.sweeps) == ["speed"] and [number for number, _ in claim.sweeps["speed"]] == [4.0, 10.0, 30.0]


def test_flipped_control_makes_a_kept_or_refuted_reading_not_tested():
    control = Control("motion", "rad", Bound("≥", 1.0), "moved")
    for figures, state in ((LOW, "kept"), (HIGH, "refuted")):
        found = {("centre", "it"): figures, ("centre", "moved"): HIGH}
        claim = judged(found, controls=[control])
        assert claim.outcomes["centre"].state == claim.verdict == state
        assert claim.controls == ("motion: ≥ 1 rad",)
        flipped = judged({**found, ("centre", "moved"): LOW}, controls=[control])
        assert flipped.outcomes["centre"].state == flipped.verdict == "not tested"
        assert flipped.counts == Counts(0, 0, 1) and flipped.outcomes["centre"].tested_seeds == 0
        assert flipped.reasons == ("not tested at centre: motion is 0.1 rad and must be ≥ 1, in 10 of 10 seeds",)


def test_reading_not_tested_turns_no_verdict():
    found = named(centre=LOW, speed__4=NAN, noise__1=HIGH) | {("speed=10", "it"): NAN, ("noise=3", "it"): HIGH}
    swept = [("speed", 10.0, "speed=10"), ("noise", 3.0, "noise=3")]
    claim = judged(found, swept)
    assert claim.verdict == "depends on z_p" and list(claim.sweeps) == ["noise"]
    assert claim.turns == "z_p: kept at centre, refuted at noise=1"


def test_reasons_join_readings_of_one_reason():
    claim = judged(named(centre=LOW, sigma_n__noise=HIGH, mu_x__zero=HIGH))
    assert claim.reasons == ("refuted at sigma_n=noise; mu_x=zero: 2, kept by 0 of 10 seeds",)
    assert str(claim.counts) == "kept in 1, refuted in 2, not tested in 0"


@pytest.mark.parametrize(("wrong", "expected"), [(1, "holds"), (2, "does not hold")])
def test_nine_of_ten_seeds_must_hold(wrong, expected):
    assert judge_own_claim("E0.1", "", "", "1", Bound("≤", 1.0), LOW[wrong:] + HIGH[:wrong]).verdict == expected


def test_own_claim_fails_for_a_diverged_belief():
    for sign in "≤≥":
        found = judge_own_claim("E0.1", "", "", "1", Bound(sign, 0.0), NAN)
        assert found.verdict == "does not hold" and math.isnan(found.outcomes["default"].median)


def test_comparison_is_decided_by_its_last_outcome():
    both = {"published": HIGH, "ours": LOW}
    claim = judge_comparison("R.1", "", "", "px", Bound("≤", 1.0), both, "a", "b")
    assert claim.verdict == "holds" and claim.counts == Counts(1, 0, 0)


def test_variants_depend_on_what_they_differ_in():
    claim = judge_variants("E6.1", "", "", "1", Bound("≤", 1.0), {"dense": HIGH, "sparse": LOW}, "sparsity")
    assert claim.verdict == "depends on sparsity" and claim.turns == "refuted: dense; kept: sparse"


def test_interval_covers_the_median():
    """Order statistics 2 and 9 of ten hold the median with 97.9 %, 3 and 8 with 89 % only."""
    assert median_interval(range(10)) == (1, 8) and median_interval(range(20)) == (5, 14)
    assert median_interval([3.0, 1.0]) == (1.0, 3.0) and all(map(math.isnan, median_interval([])))

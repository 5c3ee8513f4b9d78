import pytest

from bodylog.errors import BoundError, UsageError
from bodylog.evaluation.bounds import check_bounds, parse_bound
from bodylog.types import Score

SCORES = {"run.mcap": (Score("rmse/joint", 0.03, "rad"), Score("nees/joint", float("nan"), ""))}


BROKEN = ["rmse/joint>0.02", "rmse/joint >= 3e-2", "rmse/joint<0.04", "nees/joint>100", "nees/joint<0"]


@pytest.mark.parametrize("text", BROKEN)
def test_check_of_a_broken_bound_names_log_and_values(text):
    with pytest.raises(BoundError, match=r"run\.mcap: (rmse/joint is 0\.03|nees/joint is nan), bound broken"):
        check_bounds(SCORES, [parse_bound(text)])


@pytest.mark.parametrize("text", ["rmse/joint>0.03", "rmse/joint<0.03", "rmse/joint>1"])
def test_check_accepts_a_bound_that_holds(text):
    check_bounds(SCORES, [parse_bound(text)])


@pytest.mark.parametrize("text", ["rmse/joint", "rmse/joint=1", "rmse/joint>", ">1", "rmse/joint>1e", "a b>1"])
def test_parse_refuses_other_texts_than_bounds(text):
    with pytest.raises(UsageError, match="type a score"):
        parse_bound(text)


def test_check_of_an_unknown_score_lists_the_known():
    with pytest.raises(UsageError, match="possible: nees/joint, rmse/joint"):
        check_bounds(SCORES, [parse_bound("rmse/test>1")])


@pytest.mark.parametrize(
    ("typed", "meant"),
    [("rmse/jiont>1", "rmse/joint"), ("rsme>1", "rmse/joint"), ("fautls>0", "faults"), ("nis2/*>1", "nis"), ("nonsense>1", "")],
)
def test_a_misspelt_score_is_refused_when_it_is_typed(typed, meant):
    with pytest.raises(UsageError, match=f"did you mean {meant}"):
        parse_bound(typed)


@pytest.mark.parametrize("typed", ["fault/*>0", "*>3", "delay/*>0.05", "nis/hand>1", "rmse/*>1", "used_share/[ab]<0.5"])
def test_a_pattern_of_possible_scores_is_a_bound(typed):
    assert parse_bound(typed).limit >= 0.0

import pytest

from bodylog.errors import BoundError, UsageError
from bodylog.evaluation.bounds import check, parse
from bodylog.types import Score

SCORES = {"run.mcap": (Score("joint_rmse", 0.03, "rad"), Score("nees", float("nan"), ""))}


@pytest.mark.parametrize("text", ["joint_rmse>0.02", "joint_rmse >= 3e-2", "joint_rmse<0.04", "nees>100", "nees<0"])
def test_a_broken_bound_names_log_score_value_and_bound(text):
    with pytest.raises(BoundError, match=r"run\.mcap: (joint_rmse is 0\.03|nees is nan), bound broken"):
        check(SCORES, [parse(text)])


@pytest.mark.parametrize("text", ["joint_rmse>0.03", "joint_rmse<0.03", "joint_rmse>1"])
def test_a_bound_that_holds_is_silent(text):
    check(SCORES, [parse(text)])


@pytest.mark.parametrize("text", ["joint_rmse", "joint_rmse=1", "joint_rmse>", ">1", "joint_rmse>1e", "a b>1"])
def test_what_is_no_bound_is_refused(text):
    with pytest.raises(UsageError, match="type a score"):
        parse(text)


def test_an_unknown_score_lists_the_known():
    with pytest.raises(UsageError, match="possible: joint_rmse, nees"):
        check(SCORES, [parse("rmse>1")])

import json

import pytest

from bodylog.errors import BoundError, InputError, UsageError
from bodylog.evaluation.baseline import check, load, tolerance
from bodylog.types import Score

BEFORE = {"run.mcap": {"rmse/joint": 0.01, "rmse/joint/elbow": 0.02, "nees/joint": 1.0}}


def _found(rmse, elbow=0.02):
    errors = (Score("rmse/joint", rmse, "rad"), Score("rmse/joint/elbow", elbow, "rad"))
    return {"run.mcap": (*errors, Score("nees/joint", 9.0, ""))}


def test_an_error_within_the_tolerance_passes():
    check(_found(0.01049), BEFORE, 0.05)


@pytest.mark.parametrize("found", [_found(0.0106), _found(0.01, 0.0211), _found(float("nan"))])
def test_an_error_that_grew_names_score_and_both_values(found):
    with pytest.raises(BoundError, match=r"run\.mcap: rmse/joint\S* was 0\.0[12], is"):
        check(found, BEFORE, 0.05)


def test_a_log_the_baseline_lacks_is_an_error():
    with pytest.raises(UsageError, match=r"not in the baseline, which has run\.mcap"):
        check({"new.mcap": ()}, BEFORE, 0.05)


def test_baseline_is_read_from_results(tmp_path):
    path = tmp_path / "results.jsonl"
    path.write_text("".join(json.dumps({"name": name, "scores": scores}) + "\n" for name, scores in BEFORE.items()))
    assert load(path) == BEFORE


@pytest.mark.parametrize("text", ["{}\n", "[" * 100_000])
def test_what_is_no_baseline_is_refused(tmp_path, text):
    path = tmp_path / "results.jsonl"
    path.write_text(text)
    with pytest.raises(InputError, match=r"not a results\.jsonl"):
        load(path)


@pytest.mark.parametrize(("text", "share"), [("5%", 0.05), ("0.05", 0.05), (" 12.5 % ", 0.125)])
def test_tolerance_is_a_share(text, share):
    assert tolerance(text) == pytest.approx(share)


@pytest.mark.parametrize("text", ["five", "-5%", "5%%", ""])
def test_what_is_no_share_is_refused(text):
    with pytest.raises(UsageError, match=r"e\.g\. 5%"):
        tolerance(text)


def test_a_number_that_may_be_a_share_or_a_percentage_is_refused():
    with pytest.raises(UsageError, match="type --tolerance 5%"):
        tolerance("5")


def test_scores_of_an_earlier_version_are_refused(tmp_path) -> None:
    path = tmp_path / "results.jsonl"
    path.write_text('{"name": "run.mcap", "scores": {"joint_rmse": 0.01}}\n')
    with pytest.raises(InputError, match="joint_rmse is called rmse/joint now"):
        load(path)

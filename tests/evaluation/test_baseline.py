import json

import pytest

from bodylog.errors import BoundError, InputError, UsageError
from bodylog.evaluation.baseline import check_against_baseline, load_baseline, parse_tolerance
from bodylog.types import Score

BEFORE = {"run.mcap": {"rmse/joint": 0.01, "rmse/joint/elbow": 0.02, "nees/joint": 1.0}}


def _found(rmse, elbow=0.02):
    errors = (Score("rmse/joint", rmse, "rad"), Score("rmse/joint/elbow", elbow, "rad"))
    return {"run.mcap": (*errors, Score("nees/joint", 9.0, ""))}


def test_check_accepts_an_error_within_the_tolerance():
    check_against_baseline(_found(0.01049), BEFORE, 0.05)


@pytest.mark.parametrize("found", [_found(0.0106), _found(0.01, 0.0211), _found(float("nan"))])
def test_check_of_a_larger_error_names_score_and_values(found):
    with pytest.raises(BoundError, match=r"run\.mcap: rmse/joint\S* was 0\.0[12], is"):
        check_against_baseline(found, BEFORE, 0.05)


def test_check_refuses_a_log_the_baseline_lacks():
    with pytest.raises(UsageError, match=r"not in the baseline, which has run\.mcap"):
        check_against_baseline({"new.mcap": ()}, BEFORE, 0.05)


def test_baseline_is_read_from_results(tmp_path):
    path = tmp_path / "results.jsonl"
    path.write_text("".join(json.dumps({"name": name, "scores": scores}) + "\n" for name, scores in BEFORE.items()))
    assert load_baseline(path) == BEFORE


@pytest.mark.parametrize("text", ["{}\n", "[" * 100_000])
def test_load_refuses_other_files_than_baselines(tmp_path, text):
    path = tmp_path / "results.jsonl"
    path.write_text(text)
    with pytest.raises(InputError, match=r"not a results\.jsonl"):
        load_baseline(path)


@pytest.mark.parametrize(("text", "share"), [("5%", 0.05), ("0.05", 0.05), (" 12.5 % ", 0.125)])
def test_tolerance_is_a_share(text, share):
    assert parse_tolerance(text) == pytest.approx(share)


@pytest.mark.parametrize("text", ["five", "-5%", "5%%", ""])
def test_tolerance_refuses_other_texts_than_percentages(text):
    with pytest.raises(UsageError, match=r"e\.g\. 5%"):
        parse_tolerance(text)


def test_tolerance_refuses_an_ambiguous_number():
    with pytest.raises(UsageError, match="type --tolerance 5%"):
        parse_tolerance("5")

"""Scores of a body on test logs: their names, and their values."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bodylog import body
from bodylog.body.log_scores import score_body_on_tests
from bodylog.errors import EvidenceError, ModelError
from bodylog.settings import Settings

ERRORS = ("rmse/test", "rmse/test_u", "rmse/test_v", "median_error/test")
NAMES = (*ERRORS, "nis/test", "coverage_2sigma/test", "sightings/test")


def _scores(model, *features):
    return {one.name: one.value for one in score_body_on_tests(model, features)[0]}


@pytest.fixture(scope="module")
def learned(explored):
    """The body of one exploration."""
    return body.learn_body([explored(1, 0.003, 40.0).features], Settings(), {}).model


def test_scores_are_the_errors_against_what_was_seen(explored, learned):
    seeds = [explored(seed, 0.003, 20.0) for seed in (5, 6, 7)]
    found = _scores(learned, *(run.features for run in seeds))
    assert set(found) == {f"{name}/effector" for name in NAMES}
    assert found["sightings/test/effector"] == sum(len(run.pixels) for run in seeds)
    truth = np.concatenate([learned.senses["effector"].predict(run.angles)[0] for run in seeds])
    seen = np.concatenate([run.features.tracks["effector"].values for run in seeds])
    rms = np.sqrt(np.mean((seen - truth) ** 2, axis=0))
    assert abs(found["rmse/test_u/effector"] - rms[0]) < 0.05 and abs(found["rmse/test_v/effector"] - rms[1]) < 0.05
    squares = sum(found[f"rmse/test_{axis}/effector"] ** 2 for axis in "uv")
    np.testing.assert_allclose(found["rmse/test/effector"] ** 2, squares)
    assert 0.7 < found["nis/test/effector"] < 1.4 and found["coverage_2sigma/test/effector"] > 90


def test_score_is_bad_for_a_wrong_body(explored, learned):
    run = explored(5, 0.003, 20.0).features
    track = run.tracks["effector"]
    moved = replace(run, tracks={"effector": replace(track, values=track.values + np.array([4.0, 0.0]))})
    found = _scores(learned, moved)
    assert found["rmse/test_u/effector"] > 3.5 and found["nis/test/effector"] > 10
    assert found["coverage_2sigma/test/effector"] < 60


def test_score_refuses_a_log_it_cannot_use(explored, learned):
    run = explored(5, 0.003, 10.0).features
    with pytest.raises(EvidenceError, match="test: no sighting of effector; tracks: other"):
        score_body_on_tests(learned, [replace(run, tracks={"other": run.tracks["effector"]})])
    with pytest.raises(ModelError, match="test log 2: joint 'pan' of the body is not there"):
        joints = replace(run.joints, names=("a", "b", "c", "d"))
        score_body_on_tests(learned, [run, replace(run, joints=joints)])


def test_fit_scores_the_body_on_the_tables_given(tmp_path, run_cli, capsys):
    draw = np.random.default_rng(0)
    for name, count in {"train": 60, "test": 30}.items():
        q = draw.uniform(-0.5, 0.5, (count, 2))
        tip = np.column_stack([300 + 200 * np.sin(q[:, 0]), 200 + 150 * np.sin(q[:, 1] + 0.3)])
        tip += draw.normal(0, 0.3, tip.shape)
        rows = [",".join(map(str, row)) for row in np.hstack([q, tip]).tolist()]
        (tmp_path / f"{name}.csv").write_text("\n".join(["pan,lift,tip_u,tip_v", *rows]) + "\n")
    train, test, out = (tmp_path / name for name in ("train.csv", "test.csv", "body.npz"))
    assert run_cli("fit", train, "--test", test, "-o", out, "--json") == 0
    found = {name: one["value"] for name, one in json.loads(capsys.readouterr().out)["results"][0]["scores"].items()}
    assert {f"{name}/tip" for name in NAMES} <= set(found)
    assert found["rmse/test/tip"] < 0.8 and 0.6 < found["nis/test/tip"] < 1.6
    assert run_cli("fit", train, "--test", test, "-o", test) == 2  # a log is never overwritten
    assert run_cli("fit", train, "--test", tmp_path / "none.csv", "-o", out) == 65

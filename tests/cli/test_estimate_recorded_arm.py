"""The recorded arm, through the command line alone: three containers, no config file, scored against its truth file."""

import json

import numpy as np
import pytest

ATTAINABLE = {"reach.mcap": (0.0074, 0.0028), "reach.bag": (0.0072, 0.0030), "reach_rosbag2": (0.0072, 0.0030)}
"""RMSE in rad of a filter and a smoother given the true camera, noise and process (from the arm's README)."""


def _json(capsys, run_cli, *arguments):
    capsys.readouterr()
    assert run_cli(*arguments, "--json") == 0
    return json.loads(capsys.readouterr().out)["results"][0]


def _scores(result):
    return {name: one["value"] for name, one in result["scores"].items()}


@pytest.mark.parametrize(("method", "column", "factor"), [("filter", 0, 1.1), ("smoother", 1, 1.0)])
@pytest.mark.parametrize("log", ATTAINABLE)
def test_error_is_near_what_is_attainable_and_error_bars_are_true(
    tmp_path, capsys, run_cli, arm, arm_body, log, method, column, factor
):
    out = tmp_path / "out.mcap"
    found = _scores(_json(capsys, run_cli, "estimate", arm / log, "--body", arm_body, "-o", out, "--method", method))
    assert found["rmse/joint"] <= factor * ATTAINABLE[log][column]
    # errors of one log correlate over a second or more: their squares scatter by a fifth
    assert 0.7 <= found["nees/joint"] <= 1.3
    assert 92 <= found["coverage_2sigma/joint"] <= 98


def test_three_containers_of_one_motion_give_one_estimate(tmp_path, capsys, run_cli, arm, arm_body):
    """The bag, the rosbag2 folder, and the bag carried over into an MCAP."""
    from bodylog.annotating.read_back import read_estimate

    assert run_cli("ingest", arm / "reach.bag", "-o", tmp_path / "reach.mcap") == 0
    beliefs = []
    for log in (arm / "reach.bag", arm / "reach_rosbag2", tmp_path / "reach.mcap"):
        out = tmp_path / f"{log.name}.out.mcap"
        assert run_cli("estimate", log, "--body", arm_body, "-o", out) == 0
        beliefs.append(read_estimate(out))
    for other in beliefs[1:]:
        assert other.joints.names == beliefs[0].joints.names
        assert np.abs(other.joints.values - beliefs[0].joints.values).max() < 1e-9
        assert np.abs(other.cov - beliefs[0].cov).max() < 1e-9


def test_paper_preset_is_less_exact_than_encoders(tmp_path, capsys, run_cli, arm, arm_body):
    for log in ATTAINABLE:
        typed = ("estimate", arm / log, "--body", arm_body, "-o", tmp_path / "out.mcap")
        paper = _scores(_json(capsys, run_cli, *typed, "--method", "predictive-coding", "--preset", "paper"))
        ours = _scores(_json(capsys, run_cli, *typed))
        assert ours["rmse/joint"] < ours["rmse/encoders"] < paper["rmse/joint"] < 0.5


def test_same_log_twice_gives_the_same_bytes(tmp_path, run_cli, arm, arm_body):
    again = tmp_path / "again.npz"
    assert run_cli("fit", arm / "explore.mcap", "-o", again) == 0
    assert again.read_bytes() == arm_body.read_bytes()
    for name in ("a", "b"):
        assert run_cli("estimate", arm / "reach.mcap", "--body", arm_body, "-o", tmp_path / f"{name}.mcap") == 0
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_features_are_taken_over_instead_of_the_pictures(tmp_path, capsys, run_cli, arm, arm_body):
    features = tmp_path / "features.mcap"
    assert run_cli("extract", arm / "reach.mcap", "-o", features) == 0
    assert features.stat().st_size < (arm / "reach.mcap").stat().st_size
    scores = []
    for log in (arm / "reach.mcap", features):
        out = tmp_path / f"{log.stem}.out.mcap"
        scores.append(_scores(_json(capsys, run_cli, "estimate", log, "--body", arm_body, "-o", out)))
    assert scores[1]["rmse/joint"] == pytest.approx(scores[0]["rmse/joint"], rel=1e-4)


def test_estimate_names_only_the_drifting_encoder(tmp_path, capsys, run_cli, arm, arm_body):
    out = tmp_path / "out.mcap"
    found = _json(capsys, run_cli, "estimate", arm / "drift.mcap", "--body", arm_body, "-o", out)["faults"]
    assert [(fault["name"], fault["kind"]) for fault in found] == [("shoulder_pan_joint", "drifting")]
    assert abs(found[0]["since"] - 8.0) < 0.5 and abs(found[0]["size"]) == pytest.approx(0.3, abs=0.02)
    assert _json(capsys, run_cli, "evaluate", out)["faults"] == found
    for log in ATTAINABLE:
        assert not _json(capsys, run_cli, "estimate", arm / log, "--body", arm_body, "-o", out)["faults"]

"""Encoders that read squares: learned by a log with a reference, used on one without, on the command line."""

import json

import pytest


@pytest.fixture(scope="module")
def squared(tmp_path_factory, run_cli):
    """A folder with explore.mcap and later.mcap of encoders that read squares, and reference.toml."""
    folder = tmp_path_factory.mktemp("squared")
    (folder / "reference.toml").write_text('[topics]\nreference = "/truth/joint_states"\n')
    for name, seed, seconds in (("explore", 1, 20), ("later", 2, 8)):
        where = ("-o", folder / f"{name}.mcap", "--size", "160x120", "--variant", "moving")
        assert run_cli("record", "square-encoders", *where, "--seed", seed, "--duration", seconds) == 0
    return folder


def _printed(capsys, run_cli, *arguments):
    capsys.readouterr()
    assert run_cli(*arguments, "--json") == 0
    result = json.loads(capsys.readouterr().out)["results"][0]
    return {name: one["value"] for name, one in result["scores"].items()}, [f["text"] for f in result["findings"]]


def test_squares_are_learned_by_the_reference_and_estimated_without(tmp_path, capsys, run_cli, squared):
    body, typed = tmp_path / "body.npz", ("--config", squared / "reference.toml")
    scores, findings = _printed(capsys, run_cli, "fit", squared / "explore.mcap", "-o", body, *typed)
    assert scores["rmse/held_out_encoders/elbow_joint"] == pytest.approx(0.003, rel=0.1)
    assert any("by the reference they read shoulder_pan_joint" in text and "x^2" in text for text in findings)
    for method, most in (("filter", 0.006), ("smoother", 0.004), ("predictive-coding", 0.02)):
        typed = (squared / "later.mcap", "--body", body, "-o", tmp_path / "out.mcap", "--method", method)
        assert _printed(capsys, run_cli, "estimate", *typed)[0]["rmse/joint"] < most
    alone, _ = _printed(capsys, run_cli, "estimate", *typed[:-1], "filter", "--with", "encoders")
    assert alone["rmse/joint"] < 0.006 and 0.5 < alone["nees/joint"] < 1.5


@pytest.mark.soak
def test_fit_without_a_reference_treats_squares_as_angles(tmp_path, capsys, run_cli, squared):
    body = tmp_path / "body.npz"
    _, findings = _printed(capsys, run_cli, "fit", squared / "explore.mcap", "-o", body)
    assert not any("reference" in text for text in findings)
    typed = ("--body", body, "-o", tmp_path / "out.mcap")
    scores, _ = _printed(capsys, run_cli, "estimate", squared / "later.mcap", *typed)
    assert scores["rmse/joint"] > 1.0


def test_absent_reference_is_refused_only_by_fit(tmp_path, capsys, run_cli, robot):
    config = tmp_path / "reference.toml"
    config.write_text('[topics]\nreference = "/motion_capture/joints"\n')
    capsys.readouterr()
    assert run_cli("fit", robot / "explore.mcap", "-o", tmp_path / "b.npz", "--config", config) == 65
    assert '[topics] reference = "/motion_capture/joints", but it has no such topic' in capsys.readouterr().err
    typed = (robot / "reach.mcap", "--body", robot / "body.npz", "-o", tmp_path / "out.mcap")
    assert run_cli("estimate", *typed, "--config", config) == 0

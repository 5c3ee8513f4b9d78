"""The seven-joint arm from simulation to scores, on the command line: nothing in the path counts on three joints."""

import json

import pytest


@pytest.fixture(scope="module")
def seven(tmp_path_factory, run_cli):
    """A folder with explore.mcap, reach.mcap and body.npz of the arm of seven joints."""
    folder = tmp_path_factory.mktemp("seven")
    for scenario, name, seed, seconds in (("babble", "explore", 1, 30), ("reach", "reach", 11, 6)):
        where = ("-o", folder / f"{name}.mcap", "--arm", "seven", "--size", "160x120")
        assert run_cli("record", scenario, *where, "--seed", seed, "--duration", seconds) == 0
    assert run_cli("fit", folder / "explore.mcap", "-o", folder / "body.npz") == 0
    return folder


@pytest.mark.parametrize(("method", "most"), [("filter", 0.5), ("smoother", 0.3)])
def test_seven_joints_are_learned_and_estimated(tmp_path, capsys, run_cli, seven, method, most):
    out = tmp_path / "out.mcap"
    capsys.readouterr()
    typed = (seven / "reach.mcap", "--body", seven / "body.npz", "-o", out, "--method", method, "--json")
    assert run_cli("estimate", *typed) == 0
    scores = {name: one["value"] for name, one in json.loads(capsys.readouterr().out)["results"][0]["scores"].items()}
    assert sum(name.startswith("rmse/joint/joint_") for name in scores) == 7
    assert scores["rmse/joint"] < most * scores["rmse/encoders"]
    assert 85 <= scores["coverage_2sigma/joint"] <= 99
    assert run_cli("report", out, "-o", tmp_path / "page.html") == 0
    assert all(f"joint_{k}" in (tmp_path / "page.html").read_text() for k in range(1, 8))

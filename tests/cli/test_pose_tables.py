"""A table of still poses goes through every command that a log goes through."""

import json

import numpy as np
import pytest


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """A folder with train.csv and test.csv of a two-joint arm, its tip seen by two cameras; and the true angles."""
    folder, draw, truth = tmp_path_factory.mktemp("poses"), np.random.default_rng(0), {}
    for name, count, noise in (("train", 80, 0.0), ("test", 40, 0.03)):
        q = truth[name] = draw.uniform(-0.5, 0.5, (count, 2))
        places = [300 + 200 * np.sin(q[:, 0]), 200 + 150 * np.sin(q[:, 1] + 0.3), 90 * np.cos(q[:, 0] - q[:, 1] + 1)]
        places = np.column_stack([*places, 120 + 130 * np.sin(q[:, 1])]) + draw.normal(0, 0.3, (count, 4))
        rows = np.hstack([q + draw.normal(0, noise, q.shape), places]).tolist()
        header = "pan,lift,tip_u,tip_v,side/tip_u,side/tip_v"
        (folder / f"{name}.csv").write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return folder, truth


def test_poses_are_estimated_scored_compared_and_reported(tables, run_cli, capsys):
    folder, truth = tables
    body, out = folder / "body.npz", folder / "out.mcap"
    assert run_cli("fit", folder / "train.csv", "-o", body) == 0
    assert run_cli("estimate", folder / "test.csv", "--body", body, "-o", out) == 0
    capsys.readouterr()
    assert run_cli("evaluate", out, "--json") == 0
    assert "used/side/tip" in capsys.readouterr().out
    from bodylog.annotating.read_back import read_estimate

    found = read_estimate(out)
    order = [found.joints.names.index(name) for name in ("pan", "lift")]
    error = found.joints.values[:, order] - truth["test"]
    assert np.sqrt(np.mean(error**2)) < 0.005 and found.faults == ()
    assert run_cli("estimate", out, "--body", body, "-o", folder / "again.mcap") == 0  # what was written stays poses
    assert np.array_equal(read_estimate(folder / "again.mcap").joints.values, found.joints.values)
    assert run_cli("compare", folder / "test.csv", "--body", body, "-v") == 0
    assert "the log has still poses" in capsys.readouterr().err
    assert run_cli("report", out, "-o", folder / "report.html") == 0
    capsys.readouterr()
    assert run_cli("info", folder / "test.csv", "--json") == 0
    described = json.loads(capsys.readouterr().out)["results"][0]["log"]
    assert described["format"] == "csv" and described["joints"] == ["pan", "lift"]

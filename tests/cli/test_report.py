"""bodylog report on an annotated log of touches: the page within its size, figures beside it."""

import json

import pytest

from tests.report.pages import LIMIT, plotted, titles


@pytest.fixture(scope="module")
def touched(run_cli, robot):
    out = robot / "touched.mcap"
    typed = ("--size", "160x120", "--duration", 8, "--seed", 4)
    assert run_cli("record", "touch", "-o", robot / "touch.mcap", *typed) == 0
    assert run_cli("estimate", robot / "touch.mcap", "--body", robot / "body.npz", "-o", out) == 0
    return out


def test_page_and_figures(run_cli, touched, tmp_path):
    assert run_cli("report", touched, "-o", tmp_path / "r.html", "--figures", tmp_path / "figures") == 0
    kinds = {"recording.png", "recording.svg", "estimate.png", "estimate.svg", "overlay.png"}
    kinds |= {"reprojection.png", "reprojection.svg"}  # the simulator's logs carry a URDF
    assert {path.name for path in (tmp_path / "figures").iterdir()} == kinds
    page = (tmp_path / "r.html").read_text()
    assert len(page.encode()) < LIMIT
    shown = set(titles(page))
    assert {"elbow_joint, rad", "elbow_joint minus truth, rad", "free energy, nats", "effector u, px"} <= shown
    assert {"touches felt, strokes seen", "synchrony, 0..1", "seen minus felt, s", "skin, 0..1"} <= shown
    assert {f"{sense}: prediction error, standard deviations" for sense in ("encoders", "effector", "touch")} <= shown
    assert {mark["ink"] for mark in plotted(page)["marks"]} >= {"felt", "seen"}
    sections = ("Health of the log, per topic", "Settings", "Provenance")
    for text in ("no fault found in 3 encoders", *sections, "body_sha256", "rmse/joint"):
        assert text in page
    assert page.count("data:image/jpeg;base64,") == 6


def test_features_alone_tell_as_much_as_the_pictures(run_cli, touched, robot, tmp_path, capsys):
    raw, features, given = robot / "touch.mcap", tmp_path / "features.mcap", []
    for log, out in ((raw, features), (features, tmp_path / "again.mcap")):
        tables = tmp_path / f"{out.stem}.tables"
        assert run_cli("extract", log, "-o", out, "--csv", tables) == 0
        capsys.readouterr()
        typed = ("--body", robot / "body.npz", "-o", tmp_path / "out.mcap", "--json")
        assert run_cli("estimate", log, *typed) == 0
        files = {path.name: path.read_text() for path in tables.iterdir()}
        scores = json.loads(capsys.readouterr().out)["results"][0]["scores"]
        # features hold no true poses
        given.append((files, {name: one for name, one in scores.items() if "/effector_" not in name}))
    assert given[0][0]["strokes.csv"].count("\n") > 2 and given[0][0].keys() == given[1][0].keys()
    assert given[0][1] == given[1][1]
    for name in given[0][0]:
        first, second = (_numbers(files[name]) for files, _ in given)
        assert first == pytest.approx(second, abs=1e-8, nan_ok=True), name


def _numbers(table):
    return [float(cell or "nan") for line in table.splitlines()[1:] for cell in line.replace(" ", ",").split(",")]

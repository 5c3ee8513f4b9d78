"""Two cameras on the command line: recorded, learned, used, written, shown; and the message when one is blind."""

import json

import pytest

from tests.seeds import first_of

SWAPPED = '[topics]\ncamera = ["/side/image/compressed", "/camera/image/compressed"]\n'
BOTH = '[topics]\ncamera = ["/camera/image/compressed", "/side/image/compressed"]\n'


@pytest.fixture(scope="module")
def watched(tmp_path_factory, run_cli):
    """A folder with explore.mcap and reach.mcap of two cameras, both.toml, and a body of one camera and of both."""
    folder = tmp_path_factory.mktemp("watched")
    (folder / "both.toml").write_text(BOTH)
    for scenario, name, seed, seconds in (("babble", "explore", 1, 20), ("reach", "reach", 11, 8)):
        where = ("-o", folder / f"{name}.mcap", "--size", "160x120", "--cameras", 2)
        assert run_cli("record", scenario, *where, "--seed", seed, "--duration", seconds) == 0
    assert run_cli("fit", folder / "explore.mcap", "-o", folder / "one.npz") == 0
    typed = ("--config", folder / "both.toml")
    assert run_cli("fit", folder / "explore.mcap", "-o", folder / "two.npz", *typed) == 0
    return folder


def _printed(capsys, run_cli, *arguments):
    capsys.readouterr()
    assert run_cli(*arguments, "--json") == 0
    return json.loads(capsys.readouterr().out)["results"][0]


def _estimated(capsys, run_cli, folder, body, out, *typed):
    result = _printed(capsys, run_cli, "estimate", folder / "reach.mcap", "--body", folder / body, "-o", out, *typed)
    return {name: one["value"] for name, one in result["scores"].items()}


@pytest.mark.parametrize("method", first_of(1, ["filter", "smoother", "predictive-coding"]))
def test_two_cameras_reduce_the_error_of_one(tmp_path, capsys, run_cli, watched, method):
    typed, both = ("--method", method), ("--config", watched / "both.toml")
    one = _estimated(capsys, run_cli, watched, "one.npz", tmp_path / "1.mcap", *typed)
    two = _estimated(capsys, run_cli, watched, "two.npz", tmp_path / "2.mcap", *typed, *both)
    assert two["rmse/joint"] <= (1.02 if method == "predictive-coding" else 0.85) * one["rmse/joint"]
    if method == "filter":
        assert 0.7 <= two["nees/joint"] <= 1.6 and 0.5 <= two["nis/side/effector"] <= 1.5


def test_camera_has_its_own_track_error_and_overlay(tmp_path, capsys, run_cli, watched):
    out = tmp_path / "out.mcap"
    _estimated(capsys, run_cli, watched, "two.npz", out, "--config", watched / "both.toml")
    printed = _printed(capsys, run_cli, "info", out, "--config", watched / "both.toml")["log"]
    counts = {topic["topic"]: topic["messages"] for topic in printed["topics"]}
    assert printed["roles"]["camera"] == "/camera/image/compressed"
    assert printed["roles"]["camera/side"] == "/side/image/compressed"
    assert counts["/bodylog/track/side/effector"] == 160
    for topic in ("predicted/side/effector", "prediction_error/side/effector"):
        assert 150 <= counts[f"/bodylog/{topic}"] <= 160
    assert counts["/bodylog/annotations"] == counts["/bodylog/annotations/side"] == 160
    assert "/bodylog/track/side/hand" not in counts
    again = tmp_path / "again.mcap"
    assert run_cli("estimate", out, "--body", watched / "two.npz", "-o", again) == 0
    first, second = (_printed(capsys, run_cli, "evaluate", log) for log in (out, again))
    assert first["scores"] == second["scores"]


def test_fit_suggests_settings_for_further_cameras(capsys, run_cli, watched):
    printed = _printed(capsys, run_cli, "info", watched / "reach.mcap")["log"]
    assert printed["roles"]["camera"] == "/camera/image/compressed" and "camera/side" not in printed["roles"]
    (text,) = [f["text"] for f in printed["findings"] if f["text"].startswith("camera: ")]
    assert text.endswith("type: " + BOTH.strip().replace("\n", " "))


def test_fit_and_estimate_refuse_a_camera_without_sightings(tmp_path, capsys, run_cli, watched):
    (tmp_path / "blind.toml").write_text(BOTH + '[colours]\neffector = "magenta"\n')
    for typed in (
        ("fit", watched / "explore.mcap", "-o", tmp_path / "body.npz"),
        ("estimate", watched / "reach.mcap", "--body", watched / "two.npz", "-o", tmp_path / "out.mcap"),
    ):
        capsys.readouterr()
        assert run_cli(*typed, "--config", tmp_path / "blind.toml") == 65
        error = capsys.readouterr().err.strip()
        assert "\n" not in error and "effector: 'magenta' was never found in" in error and "seen: green" in error


def test_report_and_layout_show_every_configured_camera(tmp_path, capsys, run_cli, watched):
    first, out, typed = tmp_path / "first.mcap", tmp_path / "out.mcap", ("--config", watched / "both.toml")
    _estimated(capsys, run_cli, watched, "two.npz", first, *typed)
    assert run_cli("estimate", first, "--body", watched / "two.npz", "-o", out) == 0
    assert run_cli("report", out, "-o", tmp_path / "page.html") == 0
    page = (tmp_path / "page.html").read_text()
    assert "side/effector u, px" in page and page.count("<figcaption>side · ") == 6
    assert run_cli("layout", out, "-o", tmp_path / "layout.json") == 0
    panels = json.loads((tmp_path / "layout.json").read_text())["configById"]
    assert panels["Image!side"]["imageMode"]["imageTopic"] == "/side/image/compressed"
    (tmp_path / "side.toml").write_text('[topics]\ncamera = "/side/image/compressed"\n')
    printed = _printed(capsys, run_cli, "info", out, "--config", tmp_path / "side.toml")["log"]
    assert printed["roles"]["camera"] == "/side/image/compressed" and "camera/side" not in printed["roles"]


def test_cameras_in_another_order_than_learned_are_refused(tmp_path, capsys, run_cli, watched):
    (tmp_path / "swapped.toml").write_text(SWAPPED)
    (tmp_path / "side.toml").write_text('[topics]\ncamera = "/side/image/compressed"\n')
    reach, explore, two = watched / "reach.mcap", watched / "explore.mcap", watched / "two.npz"
    for name, *typed in (
        ("swapped.toml", "estimate", reach, "--body", two, "-o", tmp_path / "out.mcap"),
        ("side.toml", "compare", reach, "--body", two),
        ("swapped.toml", "fit", explore, "--update", two, "-o", tmp_path / "body.npz"),
    ):
        capsys.readouterr()
        assert run_cli(*typed, "--config", tmp_path / name) == 65, typed
        error = capsys.readouterr().err.strip().splitlines()[-1]
        assert "/side/image/compressed comes first here, /camera/image/compressed where the body was learned" in error
        assert "; type: " + BOTH.strip().replace("\n", " ") in error
    assert {path.suffix for path in tmp_path.iterdir()} == {".toml"}


def test_camera_replaces_an_absent_camera_of_the_body(tmp_path, capsys, run_cli, watched):
    (tmp_path / "side.toml").write_text('[topics]\ncamera = "/side/image/compressed"\n')
    side, alone, typed = tmp_path / "side.npz", tmp_path / "alone.mcap", ("--config", tmp_path / "side.toml")
    assert run_cli("fit", watched / "explore.mcap", "-o", side, *typed) == 0
    learned = _printed(capsys, run_cli, "info", side)["body"]
    assert learned["provenance"]["cameras"] == ["/side/image/compressed"]
    assert run_cli("estimate", watched / "reach.mcap", "--body", side, "-o", tmp_path / "out.mcap") == 65
    advice = '; type: [topics] camera = "/side/image/compressed", for the log as it was recorded'
    assert capsys.readouterr().err.strip().endswith(advice)
    assert run_cli("ingest", watched / "reach.mcap", "-o", alone, *typed) == 0
    printed = _printed(capsys, run_cli, "estimate", alone, "--body", side, "-o", tmp_path / "out.mcap")
    order = "/camera/image/compressed comes first here, /side/image/compressed where the body was learned"
    assert [f["text"] for f in printed["findings"] if f["text"].endswith(order)]


def test_ingest_keeps_every_camera(tmp_path, capsys, run_cli, watched):
    tidy = tmp_path / "tidy.mcap"
    assert run_cli("ingest", watched / "reach.mcap", "-o", tidy, "--config", watched / "both.toml") == 0
    printed = _printed(capsys, run_cli, "info", tidy)["log"]
    counts = {topic["topic"]: topic["messages"] for topic in printed["topics"] if "image" in topic["topic"]}
    assert counts == {"/camera/image/compressed": 160, "/side/image/compressed": 160}
    raw, again = (
        _printed(capsys, run_cli, "estimate", log, "--body", watched / "two.npz", "-o", tmp_path / "o.mcap",
              "--config", watched / "both.toml")
        for log in (watched / "reach.mcap", tidy)
    )  # fmt: skip
    # a tidy log keeps the true angles, not the true poses
    kept = _without_poses(raw["scores"])
    assert len(kept) == len(raw["scores"]) - 6 and kept == again["scores"]
    swapped = tmp_path / "swapped.toml"
    swapped.write_text(SWAPPED)
    capsys.readouterr()
    assert run_cli("ingest", watched / "reach.mcap", "-o", tmp_path / "s.mcap", "--config", swapped) == 65
    assert "name /camera/image/compressed first" in capsys.readouterr().err and not (tmp_path / "s.mcap").exists()


def _without_poses(scores):
    return {name: one for name, one in scores.items() if "/effector_" not in name}


def test_features_of_two_cameras_are_enough_with_the_same_config(tmp_path, capsys, run_cli, watched):
    features, typed = tmp_path / "features.mcap", ("--config", watched / "both.toml")
    assert run_cli("extract", watched / "reach.mcap", "-o", features, *typed) == 0
    typed = (*typed, "--body", watched / "two.npz", "-o", tmp_path / "out.mcap")
    whole, found = (_printed(capsys, run_cli, "estimate", log, *typed) for log in (watched / "reach.mcap", features))
    kept = _without_poses(whole["scores"])
    assert "side/effector" in found["health"] and found["scores"] == kept  # features have no true poses beside them


@pytest.mark.soak
def test_turning_head_is_learned_and_estimated_as_a_joint(tmp_path, capsys, run_cli):
    for scenario, name, seed, seconds in (("babble", "explore", 1, 25), ("reach", "reach", 11, 6)):
        where = ("-o", tmp_path / f"{name}.mcap", "--size", "160x120", "--turning")
        assert run_cli("record", scenario, *where, "--seed", seed, "--duration", seconds) == 0
    body = tmp_path / "body.npz"
    learned = _printed(capsys, run_cli, "fit", tmp_path / "explore.mcap", "-o", body)
    scores = {name: one["value"] for name, one in learned["scores"].items()}
    assert scores["influence/effector/head_pan_joint"] > 4 and scores["rmse/held_out/effector"] < 0.4
    found = _estimated(capsys, run_cli, tmp_path, "body.npz", tmp_path / "out.mcap")
    assert found["rmse/joint/head_pan_joint"] < 0.5 * found["rmse/encoders"] and 0.5 < found["nees/joint"] < 2.0

"""A robot with a printed tag: sources of [features] from robot.toml to a body, and remembered in what is written."""

import json
from pathlib import Path

import pytest

TOML = """
[features]
wrist = { tag = 7, dictionary = "apriltag_36h11", size = 0.08 }
rim = { tag = 7, size = 0.08, corners = true }
%s
"""


@pytest.fixture(scope="module")
def tagged(tmp_path_factory, run_cli) -> Path:
    """A folder with a log of a small robot with a tag, and its robot.toml."""
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")
    folder = tmp_path_factory.mktemp("tagged")
    how = ("--duration", 6, "--seed", 1, "--size", "480x360", "--feature", "tag")
    assert run_cli("record", "babble", "-o", folder / "log.mcap", *how) == 0
    (folder / "robot.toml").write_text(TOML % "")
    return folder


def test_tags_give_tracks_and_a_body_that_keeps_their_settings(tagged, run_cli, capsys) -> None:
    config = ("--config", tagged / "robot.toml")
    assert run_cli("extract", tagged / "log.mcap", "-o", tagged / "features.mcap", *config, "--json") == 0
    health = json.loads(capsys.readouterr().out)["results"][0]["health"]
    names = ("wrist", "rim.0", "rim.1", "rim.2", "rim.3")
    assert all(health[name]["used"] > 0.5 * health[name]["seen"] for name in names) and "effector" not in health
    # nobody says again what to look for: the log itself knows
    assert run_cli("fit", tagged / "features.mcap", "-o", tagged / "body.npz", "--json") == 0
    scores = set(json.loads(capsys.readouterr().out)["results"][0]["scores"])
    assert {f"rmse/held_out/{name}" for name in names} <= scores and "rmse/held_out/effector" not in scores

    from bodylog import pipeline
    from bodylog.settings import Settings

    read, found = pipeline.observe(tagged / "features.mcap", Settings())
    assert set(read.facts.settings.features) == {"wrist", "rim"}
    ((name, (tracks, places)),) = found.boards.items()
    assert name == "rim" and tracks == names[1:] and places[2].tolist() == [0.04, 0.04, 0.0]


def test_absent_tag_is_refused_by_name(tagged, run_cli, capsys) -> None:
    (tagged / "other.toml").write_text(TOML % "elbow = { tag = 11 }")
    code = run_cli("fit", tagged / "log.mcap", "-o", tagged / "none.npz", "--config", tagged / "other.toml")
    printed = capsys.readouterr().err
    assert code == 65 and "elbow: nothing usable" in printed and not (tagged / "none.npz").exists()


def test_point_at_the_border_is_refused_with_the_key(tagged, run_cli, capsys) -> None:
    (tagged / "point.toml").write_text("[features]\ntip = { point = [1.0, 1.0], at = 1.0 }\n")
    code = run_cli("extract", tagged / "log.mcap", "-o", tagged / "no.mcap", "--config", tagged / "point.toml")
    printed = capsys.readouterr().err
    assert code == 65 and "log.mcap: features.tip.point is [1.0, 1.0]; possible: 10 to 469" in printed
    assert not (tagged / "no.mcap").exists()


def test_tag_and_point_have_their_stated_precision(tagged) -> None:
    import numpy as np

    from bodylog import logs, pipeline
    from bodylog.config import merge_settings
    from bodylog.settings import Settings

    truth = logs.open(tagged / "log.mcap")["/truth/effector_pixel"]
    settings = merge_settings(Settings(), {"features": {"wrist": {"tag": 7}}}, "here")
    read, found = pipeline.observe(tagged / "log.mcap", settings)
    wrist = found.tracks["wrist"]
    first = int(np.flatnonzero(np.isfinite(wrist.values[:, 0]))[0])
    given = {"tip": {"point": wrist.values[first].tolist(), "at": float(wrist.t[first])}}
    tip = pipeline.observe(tagged / "log.mcap", merge_settings(Settings(), {"features": given}, "here"))[1].tracks["tip"]
    t = (truth["header.stamp"] - read.start_ns) / 1e9
    true = np.column_stack([np.interp(wrist.t, t, truth[axis]) for axis in ("point.x", "point.y")])
    known = np.abs(wrist.t[:, None] - t).min(axis=1) < 1e-3  # there is no truth while a part is out of view
    for track, least in ((wrist, 0.9), (tip, 0.5)):
        seen = np.isfinite(track.values[:, 0]) & known
        error = np.sqrt(np.mean((track.values - true)[seen] ** 2))
        assert seen.mean() > least and error < 0.08
        assert 0.5 < np.sqrt(np.mean(track.std[seen] ** 2)) / error < 2.0

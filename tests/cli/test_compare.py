"""What `compare` runs: which rows there are, what it says of them, and what its times are of."""

import contextlib
import io
import json
from dataclasses import replace

import numpy as np
import pytest

from bodylog import compare
from bodylog.body import storage
from bodylog.errors import EvidenceError
from bodylog.estimation import METHODS
from bodylog.settings import EstimationSettings, Settings
from bodylog.types import Finding
from tests.body.changed_arms import explored_without_urdf, run

from .spoilt import spoil


def _ran(capsys, run_cli, *typed):
    capsys.readouterr()
    assert run_cli("compare", *typed, "--json") == 0
    printed = json.loads(capsys.readouterr().out)["results"][0]
    return {(row["method"], tuple(row["senses"])) for row in printed["rows"]}, printed


@pytest.fixture(scope="module")
def whole(run_cli, robot):
    """What `compare --all` finds of the robot's log: rows as (method, senses), and all of it."""
    shown = io.StringIO()
    with contextlib.redirect_stdout(shown):
        typed = ("--body", robot / "body.npz", "--all", "--json")
        assert run_cli("compare", robot / "reach.mcap", *typed) == 0
    printed = json.loads(shown.getvalue())["results"][0]
    return {(row["method"], tuple(row["senses"])) for row in printed["rows"]}, printed


def test_compare_has_a_row_for_every_method_and_subset(whole):
    ran, printed = whole
    assert {
        ("filter", ("encoders", "vision")),
        ("filter", ("encoders",)),
        ("kalman", ("encoders",)),
        ("smoother", ("vision",)),
    } <= ran
    scores = {(row["method"], *row["senses"]): row["scores"] for row in printed["rows"]}
    assert all(found["rmse/joint"]["value"] > 0 for found in scores.values())
    alone, seen = (
        scores["smoother", *senses]["log_density/held_out"]["value"]
        for senses in (("encoders",), ("encoders", "vision"))
    )
    assert seen > alone


def test_subsets_without_the_encoders_are_run_only_for_all(capsys, run_cli, robot, whole):
    typed = (robot / "reach.mcap", "--body", robot / "body.npz")
    rows, printed = _ran(capsys, run_cli, *typed)
    assert ("filter", ("encoders", "vision")) in rows and ("kalman", ("encoders",)) in rows
    assert all("encoders" in senses for _, senses in rows)
    (finding_text,) = [f["text"] for f in printed["findings"] if "--all" in f["text"]]
    assert "vision" in finding_text
    assert rows < whole[0] and ("filter", ("vision",)) in whole[0]
    assert not any("--all" in f["text"] for f in whole[1]["findings"])


def test_a_log_without_encoders_has_its_rows_without_all():
    blind_joints = [("vision", "touch"), ("vision",), ("touch",)]
    assert compare.select_usual_subsets(blind_joints) == blind_joints


def test_compare_omits_senses_that_settings_exclude(tmp_path, capsys, run_cli, robot):
    config = tmp_path / "robot.toml"
    config.write_text('[estimate]\nwithout = ["vision", "touch", "elbow_joint"]\n')
    typed = (robot / "reach.mcap", "--body", robot / "body.npz", "--config", config)
    rows, printed = _ran(capsys, run_cli, *typed)
    assert rows == {(method, ("encoders",)) for method in METHODS}
    assert all("std/encoders/elbow_joint" in row["scores"] for row in printed["rows"] if row["method"] == "filter")
    assert all(row["scores"]["rmse/joint/elbow_joint"]["value"] > 0.01 for row in printed["rows"])


def test_compare_omits_a_sense_the_body_lacks(tmp_path, capsys, run_cli, robot):
    body = storage.load_body(robot / "body.npz")
    noise = replace(body.noise, senses={}, std_error={k: v for k, v in body.noise.std_error.items() if k != "effector"})
    storage.save(replace(body, senses={}, noise=noise), tmp_path / "blind.npz")
    rows, printed = _ran(capsys, run_cli, robot / "reach.mcap", "--body", tmp_path / "blind.npz")
    assert rows == {(method, ("encoders",)) for method in METHODS}
    assert not any("log_density/held_out" in row["scores"] for row in printed["rows"])


def test_warnings_name_the_rows_they_are_about(whole):
    _, printed = whole
    (text,) = [f["text"] for f in printed["findings"] if "the posture is ambiguous" in f["text"]]
    assert text.startswith("filter vision; smoother vision; ekf vision; predictive-coding vision: vision: 2 numbers")
    assert sum("predictive-coding: knows no motion" in f["text"] for f in printed["findings"]) == 1


def test_compare_refuses_a_log_without_observations(tmp_path, capsys, run_cli, robot):
    gone = ("/joint_states", "/camera/image/compressed", "/skin")
    log = spoil(robot / "reach.mcap", tmp_path / "mute.mcap", lambda *_: None, 1.0, lambda topic: topic not in gone)
    capsys.readouterr()
    assert run_cli("compare", log, "--body", robot / "body.npz") == 65
    captured = capsys.readouterr()
    assert captured.out == "" and ": no sense of " in captured.err.splitlines()[-1]


def test_compare_reports_the_loss_of_a_refused_log(tmp_path, capsys, run_cli, robot):
    log = tmp_path / "cut.mcap"
    log.write_bytes((robot / "reach.mcap").read_bytes()[:2000])
    capsys.readouterr()
    assert run_cli("compare", log, "--body", robot / "body.npz") == 65
    last = capsys.readouterr().err.splitlines()[-1]
    assert ": no sense of " in last and " lost: " in last


def test_compare_times_only_warmed_up_runs(monkeypatch, robot):
    """The pictures withheld first, then all of them: so no row pays for what the first one imports."""
    asked = []
    inner = compare.infer

    def infer(features, learned, settings):
        asked.append((settings.estimate.senses, int(np.isfinite(features.tracks["effector"].values).sum())))
        return inner(features, learned, settings)

    monkeypatch.setattr(compare, "infer", infer)
    shown = []
    settings = Settings(estimate=EstimationSettings(without=("touch",)))
    rows, _ = compare.compare_methods(robot / "reach.mcap", robot / "body.npz", settings, None, shown.append)
    assert shown == rows and len(asked) == 2 * len(rows)
    for first, then in zip(asked[::2], asked[1::2], strict=True):
        assert first[0] == then[0] and first[1] < then[1]


@pytest.mark.parametrize("asked", ["kalman", "filter"])
@pytest.mark.soak
def test_a_camera_that_was_pushed_is_where_it_is_now_for_every_method(asked):
    """Found once, by the usual method, so that rows differ by their own; without effect where nothing moved."""
    learned, settings = explored_without_urdf(), Settings(estimate=EstimationSettings(method=asked))
    assert compare.find_body_of_log(run(60), learned, settings) == (learned, ())
    moved, (finding,) = compare.find_body_of_log(run(60, camera=np.array([0.01, 0, 0, 0, 0.03, 0.01])), learned, settings)
    assert finding.text == "camera: moved since the body was learned; each row is by where it is in this log"
    turned = moved.senses["effector"].chain.frames @ learned.senses["effector"].chain.frames.transpose(0, 2, 1)
    assert np.allclose(np.arccos((np.trace(turned, axis1=1, axis2=2) - 1) / 2), np.hypot(0.03, 0.01), atol=0.02)


def test_rows_are_by_the_body_of_the_log(monkeypatch, robot):
    """And where no estimate tells it, they are by the body as learned, with the reason."""
    settings = Settings(estimate=EstimationSettings(without=("touch",)))
    inner, used = compare.infer, []
    learned = storage.load_body(robot / "body.npz")
    monkeypatch.setattr(compare, "infer", lambda f, body, s: used.append(body) or inner(f, body, s))
    moved = Finding("warning", "camera: moved")
    monkeypatch.setattr(compare, "find_body_of_log", lambda *_: (learned, (moved,)))
    _, findings = compare.compare_methods(robot / "reach.mcap", robot / "body.npz", settings)
    assert moved in findings and all(body is learned for body in used)
    monkeypatch.undo()

    def refuse(*_):
        raise EvidenceError("too few readings")

    monkeypatch.setattr(compare, "infer_with_changes", refuse)
    _, (finding,) = compare.find_body_of_log(run(60), explored_without_urdf(), settings)
    assert finding.severity == "warning" and finding.text.endswith("is looked for: too few readings")


def test_encoders_that_never_spoke_are_no_sense(robot):
    from bodylog.pipeline import observe

    _, features = observe(robot / "reach.mcap", Settings())
    body = storage.load_body(robot / "body.npz")
    mute = replace(features, joints=replace(features.joints, values=np.full_like(features.joints.values, np.nan)))
    assert compare.list_sense_subsets(mute, body, EstimationSettings(without=("touch",)))[0] == [("vision",)]
    assert compare.list_sense_subsets(mute, body, EstimationSettings(senses=("encoders",)))[0] == []

"""What `estimate` and `compare` do of what was typed on the recorded arm, and what they say of it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from .spoilt import spoil

JOINTS = ("elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint")
METHODS = ("filter", "smoother", "ekf", "kalman", "predictive-coding")


def _estimated(capsys, run_cli, log, body, out, *typed):
    """The result of an estimate that succeeds and its scores by name."""
    capsys.readouterr()
    assert run_cli("estimate", log, "--body", body, "-o", out, "--json", *typed) == 0
    result = json.loads(capsys.readouterr().out)["results"][0]
    return result, {name: one["value"] for name, one in result["scores"].items()}


def _nothing(count, message):
    return True


@pytest.fixture(scope="module")
def drift(tmp_path_factory, arm, arm_body, run_cli):
    """The log of the drifting encoder, annotated."""
    out = tmp_path_factory.mktemp("drift") / "drift.mcap"
    assert run_cli("estimate", arm / "drift.mcap", "--body", arm_body, "-o", out) == 0
    return out


@pytest.mark.parametrize("precision", ["auto", "model", "fixed"])
def test_precisions_are_printed_as_used(tmp_path, capsys, run_cli, arm, arm_body, precision):
    """The log's encoders have 0.02 rad, those of the exploration had 0.003 rad, the paper's have 1 rad."""
    out = tmp_path / "out.mcap"
    result, scores = _estimated(capsys, run_cli, arm / "reach.bag", arm_body, out, "--precision", precision)
    expected = {"auto": (0.02, 0.05), "model": (0.003, 0.1), "fixed": (1.0, 0.0)}[precision]
    for index, joint in enumerate(JOINTS):
        assert scores[f"std/encoders/{joint}"] == pytest.approx(expected[0], rel=expected[1])
        assert result["settings"]["encoder"][index] == pytest.approx(scores[f"std/encoders/{joint}"] ** 2)
        # the evidence of this log prefers white jerk; a body's motion and the paper's have white acceleration
        motion = "jerk" if precision == "auto" else "acceleration"
        assert scores[f"process_noise/{motion}/{joint}"] > 0.0
    factor = scores["variance_factor/effector"]
    assert {"auto": factor >= 1.0, "model": factor == 1.0, "fixed": factor != 1.0}[precision]
    assert run_cli("evaluate", out, "--json") == 0
    assert json.loads(capsys.readouterr().out)["results"][0]["scores"] == result["scores"]


@pytest.mark.parametrize("option", ["--precision", "--bias", "--touch", "--step", "--method"])
def test_estimate_refuses_an_unknown_choice(tmp_path, capsys, run_cli, arm, arm_body, option):
    capsys.readouterr()
    typed = ("estimate", arm / "reach.bag", "--body", arm_body, "-o", tmp_path / "out.mcap", option, "perhaps")
    assert run_cli(*typed) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and "'perhaps'" in printed and not list(tmp_path.iterdir())


def test_offsets_are_learned_when_asked_or_when_the_evidence_asks(tmp_path, capsys, run_cli, arm, arm_body, drift):
    from bodylog.annotating.read_back import read_estimate

    out = tmp_path / "out.mcap"
    assert read_estimate(drift).bias is not None and read_estimate(drift).faults
    result, scores = _estimated(capsys, run_cli, arm / "drift.mcap", arm_body, out, "--bias", "off")
    assert read_estimate(out).bias is None and not result["faults"]
    assert scores["rmse/joint/shoulder_pan_joint"] > 0.015
    for bias, shown in (("on", True), ("auto", False)):
        result, scores = _estimated(capsys, run_cli, arm / "reach.bag", arm_body, out, "--bias", bias)
        assert (read_estimate(out).bias is not None) == shown and not result["faults"]
        assert scores["rmse/joint"] < 0.009


def test_fault_is_on_its_topic_and_in_the_report(tmp_path, capsys, run_cli, drift):
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with drift.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        started = min(m.log_time for _, _, m in reader.iter_messages("/joint_states"))
        ((_, _, _, fault),) = reader.iter_decoded_messages("/bodylog/faults")
    since = fault.header.stamp.sec * 10**9 + fault.header.stamp.nanosec
    assert (fault.sense, fault.name, fault.kind, fault.unit) == ("encoders", "shoulder_pan_joint", "drifting", "rad")
    assert (since - started) / 1e9 == pytest.approx(8.0, abs=0.5) and fault.size == pytest.approx(0.3, abs=0.02)
    assert run_cli("evaluate", drift) == 0
    assert "shoulder_pan_joint: encoder drifts since " in capsys.readouterr().out
    assert run_cli("report", drift, "-o", tmp_path / "page.html") == 0
    page = (tmp_path / "page.html").read_text()
    assert "<th>std/encoders</th>" in page and "<th>process_noise/jerk</th>" in page
    table = page[page.index("Sensor faults") :]
    size = f"{fault.size:.4g} ± {fault.std:.2g} rad"
    assert table.index("shoulder_pan_joint") < table.index("drifting") < table.index(size) < 1500


@pytest.mark.parametrize("method", METHODS)
def test_estimate_stores_the_name_of_its_method(tmp_path, capsys, run_cli, arm, arm_body, method):
    from bodylog.annotating.read_back import read_estimate

    out = tmp_path / "out.mcap"
    _, scores = _estimated(capsys, run_cli, arm / "reach.bag", arm_body, out, "--method", method)
    found = read_estimate(out)
    assert found.method == method and found.joints.names == JOINTS
    assert np.isfinite(found.joints.values).all() and (np.linalg.eigvalsh(found.cov) > 0.0).all()
    assert (scores["rmse/joint"] < scores["rmse/encoders"]) == (method != "kalman")
    assert ("log_evidence" in scores) == (method in ("filter", "smoother", "ekf"))


def test_touch_has_two_readings_one_of_them_the_papers_methods_alone(tmp_path, capsys, run_cli, arm, arm_body):
    typed = (arm / "touch.mcap", arm_body, tmp_path / "out.mcap", "--method", "predictive-coding", "--touch")
    energies = []
    for form in ("likelihood", "literal"):
        _, scores = _estimated(capsys, run_cli, *typed, form)
        assert scores["used/touch"] == 6 and scores["rmse/joint"] < 0.002
        energies.append(scores["free_energy"])
    assert energies[0] != energies[1]
    (tmp_path / "out.mcap").unlink()
    typed = ("estimate", arm / "touch.mcap", "--body", arm_body, "-o", tmp_path / "out.mcap", "--touch", "literal")
    assert run_cli(*typed) == 2
    assert "for predictive-coding alone; type --touch likelihood" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_estimate_warns_of_an_unstable_step_and_suggests_another(tmp_path, capsys, run_cli, arm, arm_body):
    """Precise encoders (those of the log) need far shorter steps than those of variance 1 the paper steps for."""
    typed = (arm / "reach.bag", arm_body, tmp_path / "out.mcap", "--method", "predictive-coding", "--step", "explicit")

    def warned(*further):
        result, _ = _estimated(capsys, run_cli, *typed, *further)
        return [f["text"] for f in result["findings"] if f["text"].startswith("step: ")]

    assert not warned("--precision", "fixed")
    (text,) = warned("--with", "encoders")
    assert "Δt 0.05 s is unstable, the largest stable Δt is " in text and text.endswith(" or --step implicit")
    assert 0.0 < float(text.split("largest stable Δt is ")[1].split()[0]) < 0.05


def test_estimate_refuses_a_diverging_step_and_suggests_another(tmp_path, capsys, run_cli, arm, arm_body):
    typed = ("--body", arm_body, "-o", tmp_path / "out.mcap", "--method", "predictive-coding", "--step", "explicit")
    assert run_cli("estimate", arm / "reach.mcap", *typed) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and "the largest stable Δt is " in printed and not list(tmp_path.iterdir())


def test_compare_needs_no_truth(tmp_path, capsys, run_cli, arm, arm_body):
    log = spoil(arm / "reach.bag", tmp_path / "log.bag", _nothing, 1.0, lambda topic: "truth" not in topic)
    capsys.readouterr()
    assert run_cli("compare", log, "--body", arm_body, "--all") == 0
    head, units, *rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    figures = ["rmse/joint", "nees/joint", "coverage_2sigma/joint", "log_evidence", "log_density/held_out"]
    assert head[2:] == [*figures, "seconds"] and units == ["rad", "1", "%", "nats", "nats", "s"]
    ran = {(row[0], row[1]) for row in rows}
    both = [(m, s) for m in METHODS if m != "kalman" for s in ("encoders,vision", "encoders", "vision")]
    assert ran == {*both, ("kalman", "encoders")} and len(rows) == len(ran)
    assert all(row[2:5] == ["-"] * 3 and float(row[6]) < 10.0 and float(row[7]) > 0.0 for row in rows)
    assert all((row[5] == "-") == (row[0] in ("kalman", "predictive-coding")) for row in rows)


def test_compare_warns_of_a_method_that_refuses(tmp_path, capsys, run_cli, arm, arm_body):
    """A body whose encoders read the square of the distance from the middle of what was explored."""
    from bodylog.body import Polynomial, storage

    body = storage.load_body(arm_body)
    middle = np.median(body.senses["effector"].samples, axis=0)
    squares = Polynomial(body.joints, np.column_stack([middle**2, -2.0 * middle, np.ones(3)]))
    storage.save(replace(body, senses={**body.senses, "encoders": squares}), tmp_path / "body.npz")
    (tmp_path / "start.toml").write_text(f"[estimate]\nstart = {middle.tolist()}\n")
    log = spoil(arm / "reach.bag", tmp_path / "log.bag", _nothing, 1.0)
    capsys.readouterr()
    typed = ("compare", log, "--body", tmp_path / "body.npz", "--json", "--all")
    assert run_cli(*typed, "--config", tmp_path / "start.toml") == 0
    captured = capsys.readouterr()
    assert {row["method"] for row in json.loads(captured.out)["results"][0]["rows"]} == {"predictive-coding"}
    (refused,) = [line for line in captured.err.splitlines() if "readings turn or flatten" in line]
    for row in ("filter encoders,vision; ", "smoother vision; ", "kalman encoders: encoders: readings "):
        assert row in refused
    assert run_cli(*typed) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("bias", ["off", "on"])
def test_readings_as_they_come_give_the_belief_of_the_log(arm, arm_body, bias):
    """As `estimate --precision model` has it; a learned model knows its own variance to eight digits."""
    from bodylog import Estimator, load_body
    from bodylog.pipeline import infer, observe
    from bodylog.settings import EstimationSettings, Settings

    chosen = Settings(estimate=EstimationSettings(precision="model", bias=bias))
    _, features = observe(arm / "reach.bag", chosen)
    track, joints, body = features.tracks["effector"], features.joints, load_body(arm_body)
    whole = infer(features, body, chosen)
    robot, beliefs = Estimator(body, chosen.estimate), []
    seen = dict(zip(track.t, np.hstack([track.values, track.std]), strict=True))
    readings = dict(zip(joints.t, joints.values, strict=True))
    for t in sorted({*seen, *readings}):
        angles = dict(zip(joints.names, readings[t], strict=True)) if t in readings else None
        belief = robot.step(t, joints=angles, effector=seen.get(t))
        beliefs += [belief] if t in readings else []
    np.testing.assert_allclose([b.x for b in beliefs], whole.joints.values, atol=1e-9, rtol=0)
    np.testing.assert_allclose([b.rate for b in beliefs], whole.rate.values, atol=1e-7, rtol=0)
    std = np.sqrt(np.einsum("nii->ni", whole.cov))
    apart = (np.array([b.cov for b in beliefs]) - whole.cov) / (std[:, :, None] * std[:, None])
    np.testing.assert_allclose(apart, 0.0, atol=2e-7)

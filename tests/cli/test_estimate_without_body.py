"""Logs without a body, truth kept elsewhere, and bounds on faults: what people automate."""

import json
import re

import numpy as np
import pytest
from mcap.reader import make_reader

from bodylog.annotating.read_back import read_estimate
from bodylog.recording import recording
from bodylog.recording.robot_description import read_robot_description
from bodylog.settings import Settings
from tests.conftest import SHARED


@pytest.fixture(scope="module")
def alone(tmp_path_factory, robot, run_cli):
    out = tmp_path_factory.mktemp("alone") / "alone.mcap"
    assert run_cli("estimate", robot / "reach.mcap", "-o", out) == 0
    return out


def test_estimate_without_a_body_uses_joints_alone(robot, alone, capsys, run_cli):
    with alone.open("rb") as stream:
        topics = {channel.topic for channel in make_reader(stream).get_summary().channels.values()}
    assert {"/bodylog/joint_states", "/bodylog/joint_covariance", "/bodylog/free_energy"} <= topics
    capsys.readouterr()
    assert run_cli("estimate", robot / "reach.mcap", "-o", alone, "--json") == 0
    printed = json.loads(capsys.readouterr().out)["results"][0]
    texts = [finding["text"] for finding in printed["findings"]]
    assert any("no --body: encoders alone" in text and "--body body.npz" in text for text in texts)
    assert not printed["faults"] and "rmse/joint" in printed["scores"]


def test_undetectable_fault_breaks_its_bound_without_a_body(robot, alone, run_cli):
    name = recording.read_recording(robot / "reach.mcap", Settings()).signals.joints.names[0]
    assert run_cli("evaluate", alone, "--fail-if", "faults>0", "--fail-if", f"fault/frozen/{name}>0") == 0
    assert run_cli("evaluate", alone, "--fail-if", f"fault/encoder_offset/{name}>0.05") == 4
    assert run_cli("evaluate", alone, "--fail-if", "fault/encoder_offset/nobody>0.05") == 2


def test_estimate_checks_bounds_after_writing_the_log(tmp_path, robot, run_cli):
    typed = ("estimate", robot / "reach.mcap", "--body", robot / "body.npz", "-o", tmp_path / "a.mcap", "--fail-if")
    assert run_cli(*typed, "fault/*>0.05") == 0
    assert run_cli(*typed, "nis/encoders>0.01") == 4 and (tmp_path / "a.mcap").exists()
    assert run_cli(*typed, "nonsense") == 2


@pytest.mark.parametrize("form", ["csv", "npz", "log"])
def test_truth_kept_elsewhere_scores_as_truth_in_the_log(tmp_path, robot, alone, run_cli, capsys, form):
    read = recording.read_recording(robot / "reach.mcap", Settings())
    truth, path = read.signals.truth, tmp_path / f"truth.{form}"
    ns = read.start_ns + np.round(truth.t * 1e9).astype(np.int64)
    if form == "csv":
        rows = [",".join(map(str, [at, *row])) for at, row in zip(ns.tolist(), truth.values.tolist(), strict=True)]
        path.write_text("\n".join([",".join(["t", *truth.names]), *rows]))
    elif form == "npz":
        np.savez(path, t=truth.t, q=truth.values, names=np.array(truth.names), start=read.start_ns)
    else:
        path = robot / "reach.mcap"
    printed = []
    for typed in ((), ("--truth", path)):
        capsys.readouterr()
        assert run_cli("evaluate", alone, "--json", *typed) == 0
        scores = json.loads(capsys.readouterr().out)["results"][0]["scores"]
        printed.append({name: one["value"] for name, one in scores.items()})
    assert printed[0]["rmse/joint"] == pytest.approx(printed[1]["rmse/joint"], rel=1e-4)


def test_truth_of_other_joints_or_another_time_is_refused_with_what_is_possible(tmp_path, alone, run_cli, capsys):
    name = recording.read_recording(alone, Settings()).signals.joints.names[0]
    others = (("t,nobody\n0,1\n1,1\n", "its columns are nobody"), (f"t,{name}\n900,1\n901,1\n", "it is from 900"))
    for text, why in others:
        (tmp_path / "a.csv").write_text(text)
        assert run_cli("evaluate", alone, "--truth", tmp_path / "a.csv") == 65
        assert why in capsys.readouterr().err


def test_estimate_without_a_body_handles_a_real_robot(tmp_path, run_cli, capsys):
    log = SHARED / "ipab-slmc__kuka_honeypot_demo" / "data" / "test.bag"
    if not log.exists():
        pytest.skip(f"{log} is not at hand")
    assert run_cli("estimate", log, "-o", tmp_path / "a.mcap", "-v", "--fail-if", "faults>0") == 0
    assert "readings that repeat the one before: lwr_arm_4_joint 67%" in capsys.readouterr().err


def test_joints_outside_of_a_urdfs_limits_are_named(tmp_path, robot, run_cli, capsys):
    """The log's own URDF accuses nobody; one with closer limits does; a body knows its robot."""
    text = read_robot_description(robot / "reach.mcap").urdf
    out, closer = tmp_path / "a.mcap", tmp_path / "closer.urdf"
    elbow = re.compile(r'(name="elbow_joint".*?)<limit [^>]*>', re.DOTALL)
    closer.write_text(elbow.sub(r'\1<limit lower="-9" upper="-8"/>', text))
    assert closer.read_text() != text
    typed = ("estimate", robot / "reach.mcap", "-o", out, "-v")
    assert run_cli(*typed, "--urdf", "log") == 0 and run_cli(*typed) == 0
    assert "outside of" not in capsys.readouterr().err
    assert run_cli(*typed, "--urdf", closer) == 0
    assert "elbow_joint: " in (printed := capsys.readouterr().err) and f"outside of -9 to -8 rad ({closer})" in printed
    assert run_cli(*typed, "--urdf", closer, "--body", robot / "body.npz") == 2
    assert run_cli("estimate", closer, "-o", closer, "--urdf", closer) == 2
    closer.write_text("<robot/>")
    assert run_cli(*typed, "--urdf", closer) == 65
    assert "closer.urdf: has no <link>" in capsys.readouterr().err


def test_still_poses_without_a_body_are_what_their_encoders_read(tmp_path, run_cli, capsys):
    rng = np.random.default_rng(3)
    rows = rng.uniform(-1.0, 1.0, (40, 2))
    (tmp_path / "poses.csv").write_text("pan,lift\n" + "".join(f"{a},{b}\n" for a, b in rows))
    assert run_cli("estimate", tmp_path / "poses.csv", "-o", tmp_path / "a.mcap") == 0
    assert "warning: " not in capsys.readouterr().err
    belief = read_estimate(tmp_path / "a.mcap", recording.read_recording(tmp_path / "a.mcap", Settings()).start_ns)
    assert np.abs(belief.joints.values - rows).max() < 1e-5

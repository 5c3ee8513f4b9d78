"""Logs spoilt in one way each, as .mcap and as .bag: refused by name, or read and the loss counted; nothing is left."""

import json

import numpy as np
import pytest

from .spoilt import later, spoil

SECONDS = 3.0
PLACES = pytest.mark.parametrize("log", ["reach.mcap", "reach.bag"])


@pytest.fixture
def made(tmp_path, arm):
    """Spoil the first seconds of a log of the arm."""

    def make(log, change, until=SECONDS, **how):
        return spoil(arm / log, tmp_path / f"spoilt_{log}", change, until, **how)

    return make


def _estimated(capsys, run_cli, log, body, out, *typed):
    capsys.readouterr()
    assert run_cli("estimate", log, "--body", body, "-o", out, "--json", *typed) == 0
    result = json.loads(capsys.readouterr().out)["results"][0]
    return result, {name: one["value"] for name, one in result["scores"].items()}


def _refused(capsys, run_cli, log, body, out, *typed):
    """The one line said by an estimate that ends with 65 and leaves nothing."""
    capsys.readouterr()
    before = sorted(out.parent.iterdir())
    assert run_cli("estimate", log, "--body", body, "-o", out, *typed) == 65
    printed = capsys.readouterr().err.strip()
    assert "\n" not in printed and printed.startswith(f"bodylog: {log}: ")
    assert sorted(out.parent.iterdir()) == before
    return printed


def _nothing(count, message):
    return True


@PLACES
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_readings_that_are_no_numbers_are_passed_over(tmp_path, capsys, run_cli, arm_body, made, log, value):
    def change(count, message):
        message.position[0] = value if 20 <= count < 30 else message.position[0]
        return True

    result, scores = _estimated(capsys, run_cli, made(log, change), arm_body, tmp_path / "out.mcap")
    assert not result["faults"]
    assert scores["rmse/joint"] < 0.012 < 0.018 < scores["rmse/encoders"] < 0.022


def _times_text(result):
    (printed,) = [one["text"] for one in result["findings"] if "times run backwards" in one["text"]]
    assert printed.startswith("joints ")
    return printed


@PLACES
@pytest.mark.parametrize("seconds", [1.0, 1.003])
def test_estimate_drops_a_few_backward_timestamps(tmp_path, capsys, run_cli, arm_body, made, log, seconds):
    def change(count, message):
        later(message, -seconds if 60 <= count < 70 else 0.0)
        return True

    result, scores = _estimated(capsys, run_cli, made(log, change), arm_body, tmp_path / "out.mcap")
    assert "10 of 150 messages, 1.200 to 1.380 s after its first" in _times_text(result)
    assert any("rejected 10 (time runs backwards) of 150" in one["text"] for one in result["findings"])
    assert scores["used/encoders"] == 140 and scores["rmse/joint"] < scores["rmse/encoders"]
    assert not result["faults"]


@PLACES
def test_estimate_names_and_ignores_a_backward_clock(tmp_path, capsys, run_cli, arm_body, made, log):
    def change(count, message):
        later(message, -0.04 * count)
        return True

    result, scores = _estimated(capsys, run_cli, made(log, change, until=6.0), arm_body, tmp_path / "out.mcap")
    assert "log time is used instead" in _times_text(result)
    assert scores["used/encoders"] == 300 and scores["rmse/joint"] < 0.6 * scores["rmse/encoders"]
    assert not result["faults"]


@PLACES
def test_estimate_names_a_clock_that_was_set_back_and_mends_it(tmp_path, capsys, run_cli, arm_body, made, log):
    def change(count, message):
        later(message, -2.0 * (count >= 150))
        return True

    result, scores = _estimated(capsys, run_cli, made(log, change, until=6.0), arm_body, tmp_path / "out.mcap")
    stepped = [one["text"] for one in result["findings"] if "stepped" in one["text"]]
    assert len(stepped) == 1 and stepped[0].startswith("joints ")
    assert "its clock stepped back by 2.000 s, 2.980 s after its first message" in stepped[0]
    assert scores["used/encoders"] == 300 and scores["rmse/joint"] < 0.6 * scores["rmse/encoders"]
    assert not result["faults"]


@PLACES
def test_joints_of_another_robot_are_named_beside_the_bodys(tmp_path, capsys, run_cli, arm_body, made, log):
    def change(count, message):
        message.name = [f"other_{name}" for name in message.name]
        return True

    printed = _refused(capsys, run_cli, made(log, change), arm_body, tmp_path / "out.mcap")
    for name in ("elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint"):
        assert f" {name}" in printed and f"other_{name}" in printed


@PLACES
def test_estimate_names_an_absent_joint_of_the_body(tmp_path, capsys, run_cli, arm_body, made, log):
    def change(count, message):
        message.name = ["wrist_9_joint" if name == "elbow_joint" else name for name in message.name]
        return True

    printed = _refused(capsys, run_cli, made(log, change), arm_body, tmp_path / "out.mcap")
    assert ": elbow_joint missing;" in printed and "wrist_9_joint" in printed


@PLACES
@pytest.mark.parametrize("spoken", ["nothing", "no numbers", "one joint no numbers"])
def test_encoders_that_never_say_a_number_are_refused(tmp_path, capsys, run_cli, arm_body, made, log, spoken):
    def change(count, message):
        message.position[: 1 if spoken.startswith("one") else None] = np.nan
        return spoken != "nothing"

    printed = _refused(capsys, run_cli, made(log, change), arm_body, tmp_path / "out.mcap")
    assert "joints: " in printed


@PLACES
def test_encoders_of_fewer_positions_than_names_are_refused_with_why(tmp_path, capsys, run_cli, arm_body, made, log):
    def change(count, message):
        message.position = message.position[:4]
        return True

    printed = _refused(capsys, run_cli, made(log, change), arm_body, tmp_path / "out.mcap")
    assert "/joint_states was considered, but has no usable message: 150 (4 positions for 6 names)" in printed


@PLACES
@pytest.mark.parametrize("sense", ["vision", "touch"])
def test_estimate_refuses_a_named_sense_without_observations(tmp_path, capsys, run_cli, arm_body, made, log, sense):
    blind = made(log, _nothing, kept=lambda topic: "image" not in topic)
    printed = _refused(capsys, run_cli, blind, arm_body, tmp_path / "out.mcap", "--with", f"encoders,{sense}")
    assert sense in printed


@PLACES
def test_senses_nobody_named_may_be_absent(tmp_path, capsys, run_cli, arm_body, made, log):
    blind = made(log, _nothing, kept=lambda topic: "image" not in topic)
    _, scores = _estimated(capsys, run_cli, blind, arm_body, tmp_path / "out.mcap")
    assert scores["used/encoders"] == 150 and "nis/effector" not in scores
    assert scores["rmse/joint"] < scores["rmse/encoders"]


@PLACES
@pytest.mark.parametrize("what", ["frozen", "dead", "jumping"])
def test_encoders_that_lie_are_named_with_when_and_how_much(tmp_path, capsys, run_cli, arm_body, made, log, what):
    held = {}

    def change(count, message):
        at = list(message.name).index("shoulder_pan_joint")
        if count < 150:
            held["last"] = message.position[at]
        else:
            lie = {"frozen": held["last"], "dead": np.nan, "jumping": message.position[at] + 0.4}
            message.position[at] = lie[what]
        return True

    result, scores = _estimated(capsys, run_cli, made(log, change, until=6.0), arm_body, tmp_path / "out.mcap")
    (fault,) = result["faults"]
    assert (fault["name"], fault["kind"]) == ("shoulder_pan_joint", what)
    assert fault["since"] == pytest.approx(3.0, abs=0.05)
    assert fault["size"] == pytest.approx(0.4 if what == "jumping" else 0.0, abs=0.03)
    assert scores["rmse/joint/shoulder_pan_joint"] < 0.012


def test_log_truncated_before_any_message_is_refused(tmp_path, capsys, run_cli, arm, arm_body):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((arm / "reach.mcap").read_bytes()[:20_000])
    printed = _refused(capsys, run_cli, cut, arm_body, tmp_path / "out.mcap")
    assert "no sense has measurements" in printed and "from byte 36 19964 bytes" in printed


def test_log_truncated_inside_its_chunk_is_read_partly(tmp_path, capsys, run_cli, arm, arm_body):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((arm / "reach.mcap").read_bytes()[:300_000])
    capsys.readouterr()
    assert run_cli("estimate", cut, "--body", arm_body, "-o", tmp_path / "out.mcap", "--json") == 3
    result = json.loads(capsys.readouterr().out)["results"][0]
    (lost,) = [finding["text"] for finding in result["findings"] if finding["severity"] == "lost"]
    assert "from byte 36 " in lost and "4.501 s lost: the file ends in this chunk, after 299964 bytes, which" in lost
    scores = {name: one["value"] for name, one in result["scores"].items()}
    assert scores["used/encoders"] == 134 and scores["used/effector"] > 28
    assert scores["rmse/joint"] < 0.6 * scores["rmse/encoders"]
    assert run_cli("info", cut, "--strict") == 65

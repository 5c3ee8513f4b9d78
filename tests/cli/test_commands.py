"""Each command as it is typed: what it leaves, what it prints, and what it says, with which code, when it cannot."""

import json
import shutil

import pytest

from .spoilt import spoil


def _printed(capsys, code, run_cli, *arguments):
    """What was said on standard error by a command that ends with `code`, which is one line when it fails."""
    capsys.readouterr()
    assert run_cli(*arguments) == code
    printed = capsys.readouterr().err
    if code in (2, 65):
        assert printed.strip().count("\n") == 0, printed
        assert "Traceback" not in printed
    return printed


def test_info_is_a_list_with_an_object_per_log(capsys, run_cli, robot):
    capsys.readouterr()
    assert run_cli("info", robot / "explore.mcap", robot / "reach.mcap", "--json") == 0
    explore, reach = (one["log"] for one in json.loads(capsys.readouterr().out)["results"])
    assert {"path", "format", "start_ns", "duration_s", "topics", "roles", "joints", "findings"} <= set(reach)
    assert reach["roles"]["joints"] == "/joint_states" and reach["roles"]["truth"] == "/truth/joint_states"
    assert {"topic", "type", "messages", "rate_hz"} <= set(reach["topics"][0])
    assert len(explore["joints"]) == 6


def test_estimate_then_evaluate_say_the_same_scores(tmp_path, capsys, run_cli, robot):
    out = tmp_path / "out.mcap"
    capsys.readouterr()
    assert run_cli("estimate", robot / "reach.mcap", "--body", robot / "body.npz", "-o", out, "--json") == 0
    estimated = json.loads(capsys.readouterr().out)["results"][0]
    assert run_cli("evaluate", out, "--json") == 0
    evaluated = json.loads(capsys.readouterr().out)["results"][0]
    assert estimated["output"] == str(out)
    assert {"scores", "health", "findings", "settings"} <= set(estimated)
    values = {name: one["value"] for name, one in estimated["scores"].items()}
    for name, score in evaluated["scores"].items():
        assert score["value"] == pytest.approx(values[name], rel=1e-9, abs=1e-12)
    assert values["rmse/joint"] < values["rmse/encoders"]


def test_broken_bound_is_named_and_exits_4(tmp_path, capsys, run_cli, robot):
    out = tmp_path / "out.mcap"
    assert run_cli("estimate", robot / "reach.mcap", "--body", robot / "body.npz", "-o", out) == 0
    assert "rmse/joint" in _printed(capsys, 4, run_cli, "evaluate", out, "--fail-if", "rmse/joint>1e-9")
    assert run_cli("evaluate", out, "--fail-if", "rmse/joint>1") == 0


def test_evaluate_continues_after_an_empty_log(tmp_path, capsys, run_cli, robot):
    out = tmp_path / "out.mcap"
    assert run_cli("estimate", robot / "reach.mcap", "--body", robot / "body.npz", "-o", out) == 0
    (tmp_path / "empty.mcap").write_bytes(b"")
    typed = ("evaluate", out, tmp_path / "empty.mcap", "--json", "--fail-if", "rmse/joint>1e-9")
    capsys.readouterr()
    assert run_cli(*typed) == 65
    shown, printed = capsys.readouterr()
    assert [one["input"] for one in json.loads(shown)["results"]] == [str(out)]
    assert "empty.mcap: the file is empty" in printed and "rmse/joint is" in printed


def test_named_senses_are_used_and_no_others(tmp_path, capsys, run_cli, robot):
    out = tmp_path / "out.mcap"
    typed = ("estimate", robot / "reach.mcap", "--body", robot / "body.npz", "-o", out, "--json")
    capsys.readouterr()
    assert run_cli(*typed, "--with", "encoders") == 0
    scores = set(json.loads(capsys.readouterr().out)["results"][0]["scores"])
    assert "used/encoders" in scores and "nis/effector" not in scores
    assert run_cli(*typed, "--without", "encoders") == 0
    scores = set(json.loads(capsys.readouterr().out)["results"][0]["scores"])
    assert "nis/effector" in scores and "nis/encoders" not in scores


def test_info_and_doctor_continue_after_an_absent_log(capsys, run_cli, robot):
    for name, key in (("info", "log"), ("doctor", "findings")):
        capsys.readouterr()
        logs = (robot / "reach.mcap", robot / "absent.mcap", robot / "explore.mcap")
        assert run_cli(name, *logs, "--json") == 65
        shown = capsys.readouterr()
        results = json.loads(shown.out)["results"]
        assert [one["input"] for one in results if key in one] == [str(logs[0]), str(logs[2])]
        assert shown.err == f"bodylog: {logs[1]}: there is no such file or folder; check the name\n"
        assert run_cli(name, logs[1], robot / "nor.this") == 65
        assert capsys.readouterr().err.count("\n") == 2


KEYS = {"input", "output", "verdict", "scores", "health", "findings", "faults", "settings"}


def test_json_output_has_the_same_keys_in_every_command(tmp_path, capsys, run_cli, robot):
    reach, body, out = robot / "reach.mcap", ("--body", robot / "body.npz"), tmp_path / "out.mcap"
    for typed in (
        ("estimate", reach, *body, "-o", out),
        ("evaluate", out),
        ("extract", reach, "-o", tmp_path / "features.mcap"),
        ("ingest", reach, "-o", tmp_path / "tidy.mcap"),
        ("fit", robot / "explore.mcap", "-o", tmp_path / "body.npz"),
        ("compare", tmp_path / "features.mcap", *body),
        ("report", out, "-o", tmp_path / "report.html"),
        ("layout", out, "-o", tmp_path / "layout.json"),
        ("plot", out, "-o", tmp_path / "plot.png"),
        ("colours", reach),
        ("info", reach, robot / "body.npz"),
        ("doctor", reach),
        ("batch", reach, *body, "-o", tmp_path / "batch"),
        ("record", "reach", "--duration", 1, "--size", "160x120", "-o", tmp_path / "log.mcap"),
    ):
        capsys.readouterr()
        assert run_cli(*typed, "--json") == 0
        whole = json.loads(capsys.readouterr().out)
        assert set(whole) == {"bodylog", "command", "results"} and whole["command"] == typed[0]
        for one in whole["results"]:
            assert set(one) >= KEYS, typed
            assert all(set(score) - {"std"} == {"value", "unit"} for score in one["scores"].values())
    assert run_cli("config", "--json") == 0
    assert json.loads(capsys.readouterr().out)["results"][0]["settings"]["estimate"]["method"] == "filter"


def _wrong(robot, tmp_path):
    """Name -> (exit code, what must be said, what is typed)."""
    body, out = robot / "body.npz", tmp_path / "out.mcap"
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "text.bag").write_text("this is no log\n" * 50)
    (tmp_path / "topic.toml").write_text('[topics]\njoints = "/nowhere"\n')
    (tmp_path / "joint.toml").write_text('[body]\njoints = ["knee_joint"]\n')
    (tmp_path / "key.toml").write_text("[topics]\njoint = '/joint_states'\n")
    (tmp_path / "not.npz").write_bytes(b"PK not a model")
    reach, explore, absent = robot / "reach.mcap", robot / "explore.mcap", tmp_path / "absent.mcap"
    estimate = ("-o", out, "--body", body)
    return {
        "empty log": (65, "empty.mcap", ("estimate", tmp_path / "empty.mcap", *estimate)),
        "not a log": (65, "text.bag", ("estimate", tmp_path / "text.bag", *estimate)),
        "no such log": (65, "absent.mcap", ("estimate", absent, *estimate)),
        "missing topic": (65, "/nowhere", ("estimate", reach, *estimate, "--config", tmp_path / "topic.toml")),
        "too many steps": (2, "number from 0.001 to 10000 Hz", ("estimate", reach, *estimate, "--rate", "1e6")),
        "unknown joint": (65, "knee_joint", ("fit", explore, "-o", out, "--config", tmp_path / "joint.toml")),
        "unknown key": (2, "did you mean joints", ("fit", explore, "-o", out, "--config", tmp_path / "key.toml")),
        "not a model": (65, "not.npz", ("estimate", reach, "-o", out, "--body", tmp_path / "not.npz")),
        "unknown method": (2, "filter", ("estimate", reach, *estimate, "--method", "magic")),
        "unknown method, absent log": (2, "filter", ("estimate", absent, *estimate, "--method", "magic")),
        "empty senses": (2, "estimate.senses is ('',)", ("estimate", reach, *estimate, "--with", "")),
        "empty joints": (2, "body.joints is ('',)", ("fit", explore, "-o", out, "--joints", "")),
        "no number": (2, "possible: number from", ("extract", reach, "-o", out, "--clock-offset", "nan")),
        "no body for a batch": (2, "needs either", ("batch", reach, "-o", tmp_path / "batch")),
        "unknown sense": (2, "encoders", ("estimate", reach, *estimate, "--with", "smell")),
        "unheard sense": (65, "touch", ("estimate", reach, *estimate, "--with", "encoders,touch")),
        "unknown scenario": (2, "babble", ("record", "dance", "-o", out)),
        "absent folder": (73, "mkdir", ("record", "babble", "-o", tmp_path / "no" / "out.mcap", "--duration", 1)),
        "no estimate": (65, "bodylog estimate", ("evaluate", reach)),
        "onto itself": (2, "is also an input", ("estimate", reach, "-o", reach, "--body", body)),
        "unknown option": (2, "--help", ("estimate", reach, "--bodi", body)),
        "bad clock offset": (2, "possible: auto, or seconds", ("extract", reach, "-o", out, "--clock-offset", "soon")),
        "bad delay": (2, "auto, off, or NAME=S", ("estimate", reach, *estimate, "--delay", "camera=soon")),
        "no such camera": (2, "'left' found, possible: joints", ("estimate", reach, *estimate, "--delay", "left=0.05")),
        "endless delay": (2, "possible: auto, off, or {NAME", ("fit", explore, "-o", out, "--delay", "camera=inf")),
        "long delay": (2, "from -3600 to 3600 s", ("estimate", reach, *estimate, "--delay", "1e9")),
        "no window": (2, "not before --end 2", ("ingest", reach, "-o", out, "--start", "3", "--end", "2")),
        "no second": (2, "finite number", ("ingest", reach, "-o", out, "--start", "nan")),
        "no length": (2, "finite number", ("record", "reach", "-o", out, "--duration", "inf")),
        "no memory": (2, "must be a size", ("batch", reach, "-o", tmp_path / "b", *estimate[2:], "--memory", "0")),
        "no name": (2, "must not be empty", ("estimate", "", *estimate)),
        "no name for a batch": (2, "must not be empty", ("batch", "", "-o", tmp_path / "batch", *estimate[2:])),
        "no bound": (2, "not a bound", ("evaluate", reach, "--fail-if", "rmse/joint")),
    }


NAMES = (
    *("empty log", "not a log", "no such log", "missing topic", "unknown joint", "unknown key", "not a model"),
    *("unknown method", "unknown sense", "unheard sense", "unknown scenario", "absent folder", "no estimate"),
    *("onto itself", "no bound", "unknown option", "bad clock offset", "unknown method, absent log", "empty senses"),
    *("empty joints", "no number", "no body for a batch", "too many steps", "bad delay", "no such camera"),
    *("endless delay", "long delay", "no window", "no second", "no length", "no memory", "no name"),
    "no name for a batch",
)


@pytest.mark.parametrize("name", NAMES)
def test_failed_command_prints_one_line_and_leaves_nothing(tmp_path, capsys, run_cli, robot, name):
    code, printed, typed = _wrong(robot, tmp_path)[name]
    before = {path.name for path in tmp_path.iterdir()}
    kept = (robot / "reach.mcap").read_bytes()
    assert printed in _printed(capsys, code, run_cli, *typed)
    assert {path.name for path in tmp_path.iterdir()} == before
    assert (robot / "reach.mcap").read_bytes() == kept


def test_failed_command_cases_are_all_listed(tmp_path, robot):
    assert set(_wrong(robot, tmp_path)) == set(NAMES)


def test_body_of_another_robot_names_the_joints_of_both(tmp_path, capsys, run_cli, robot, arm):
    out = tmp_path / "out.mcap"
    typed = ("record", "babble", "-o", tmp_path / "seven.mcap", "--arm", "seven", "--duration", 2, "--size", "160x120")
    assert run_cli(*typed) == 0
    estimate = ("estimate", tmp_path / "seven.mcap", "--body", robot / "body.npz", "-o", out)
    printed = _printed(capsys, 65, run_cli, *estimate)
    assert "shoulder_pan_joint" in printed
    assert not out.exists()


def test_truncated_log_is_used_until_damage_and_exits_3(tmp_path, capsys, run_cli, robot):
    whole = (robot / "explore.mcap").read_bytes()
    cut, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    cut.write_bytes(whole[: len(whole) * 3 // 4])
    printed = _printed(capsys, 3, run_cli, "estimate", cut, "--body", robot / "body.npz", "-o", out)
    assert "lost" in printed
    assert out.exists()


def test_strict_refuses_a_truncated_log(tmp_path, capsys, run_cli, robot):
    whole = (robot / "explore.mcap").read_bytes()
    cut, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    cut.write_bytes(whole[: len(whole) * 3 // 4])
    for typed in (("info", cut), ("estimate", cut, "--body", robot / "body.npz", "-o", out), ("fit", cut, "-o", out)):
        assert "--strict" in _printed(capsys, 65, run_cli, *typed, "--strict")
    assert not out.exists()


def test_doctor_heeds_strict_and_config_as_the_others_do(tmp_path, capsys, run_cli, robot):
    cut, config = tmp_path / "cut.mcap", tmp_path / "robot.toml"
    cut.write_bytes((robot / "reach.mcap").read_bytes()[:-60_000])
    config.write_text('[topics]\njoint = "/j"\n')
    assert run_cli("doctor", cut) == 3
    assert run_cli("doctor", cut, "--strict") == 65
    assert run_cli("doctor", robot / "reach.mcap", "--strict") == 0
    assert run_cli("doctor", robot / "reach.mcap", "--config", config) == 2
    assert "did you mean joints" in capsys.readouterr().err


def test_doctor_names_the_damage_and_repair_leaves_a_sound_log(tmp_path, capsys, run_cli, robot):
    whole = (robot / "explore.mcap").read_bytes()
    cut, sound = tmp_path / "cut.mcap", tmp_path / "sound.mcap"
    cut.write_bytes(whole[: len(whole) * 3 // 4])
    assert run_cli("doctor", robot / "reach.mcap") == 0
    assert run_cli("doctor", cut, "--repair", sound) == 3
    assert run_cli("doctor", sound) == 0
    assert run_cli("info", sound) == 0


def test_plots_are_pictures(tmp_path, run_cli, robot):
    for source in ("reach.mcap", "body.npz"):
        assert run_cli("plot", robot / source, "-o", tmp_path / "plot.png") == 0
        assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_features_and_colours_list_the_arms_target_first(tmp_path, capsys, run_cli, robot):
    sheet = tmp_path / "sheet.png"
    for name in ("features", "colours"):
        capsys.readouterr()
        assert run_cli(name, robot / "explore.mcap", "-o", sheet, "--json") == 0
        first = json.loads(capsys.readouterr().out)["results"][0]["candidates"][0]
        assert first["name"] == "green" and first["arm"] and first["explained"] > 0.9
        assert first["line"].startswith("effector = {low = [")
        assert sheet.read_bytes().startswith(b"\x89PNG")


def test_features_explains_its_columns_and_prints_lines_to_paste(tmp_path, capsys, run_cli, robot):
    from bodylog.config import load_settings

    capsys.readouterr()
    assert run_cli("features", robot / "explore.mcap") == 0
    head, _, *rows = capsys.readouterr().out.splitlines()
    assert head.endswith("looked at; moves by: standard deviation of its place; -: not computed")
    at = rows.index("# paste one of these lines under [features] in robot.toml")
    assert len(rows[:at]) == len(rows[at + 1 :]) and not any(line.startswith("#") for line in rows[at + 1 :])
    (tmp_path / "robot.toml").write_text("\n".join(["[features]", rows[at + 1]]))
    assert load_settings(tmp_path / "robot.toml").features.keys() == {"effector"}


def test_features_shows_no_share_where_none_is_computed(tmp_path, capsys, run_cli, robot):
    def kept(topic):
        return "joint" not in topic

    still = spoil(robot / "explore.mcap", tmp_path / "still.mcap", lambda *_: None, 9.0, kept)
    capsys.readouterr()
    assert run_cli("features", still) == 0
    (green,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("green ")]
    assert green.split()[4:] == ["-", "no", "joint", "moves"]
    assert run_cli("features", still, "--json") == 0
    candidates = json.loads(capsys.readouterr().out)["results"][0]["candidates"]
    assert candidates and all(one["explained"] is None for one in candidates)


def test_plot_and_features_give_the_same_advice(tmp_path, capsys, run_cli, robot):
    """The line for robot.toml that `plot` prints of a log whose marker is not the default one is that of `features`."""
    log = tmp_path / "arm.mcap"
    drawn = ("--duration", 8, "--seed", 3, "--size", "320x240", "--feature", "tag")
    assert run_cli("record", "babble", "-o", log, *drawn) == 0
    capsys.readouterr()
    assert run_cli("features", log, "--json") == 0
    first = json.loads(capsys.readouterr().out)["results"][0]["candidates"][0]
    assert run_cli("plot", log, "-o", tmp_path / "arm.png", "-v") == 0
    assert f"ready for robot.toml: [features] {first['line']}" in capsys.readouterr().err


def test_record_writes_the_same_bytes_twice(tmp_path, run_cli, robot):
    typed = ("record", "reach", "--duration", 4, "--seed", 2, "--size", "160x120", "-o", tmp_path / "again.mcap")
    assert run_cli(*typed) == 0
    assert (tmp_path / "again.mcap").read_bytes() == (robot / "reach.mcap").read_bytes()


def test_absent_log_is_an_error(tmp_path, capsys, run_cli, robot):
    shutil.copy(robot / "reach.mcap", tmp_path / "reach.mcap")
    (tmp_path / "reach.mcap").unlink()
    assert "reach.mcap" in _printed(capsys, 65, run_cli, "info", tmp_path / "reach.mcap")


def test_extract_exports_features_as_tables(tmp_path, run_cli, robot):
    typed = ("extract", robot / "reach.mcap", "-o", tmp_path / "features.mcap", "--csv", tmp_path / "tables")
    assert run_cli(*typed) == 0
    assert (tmp_path / "tables" / "tracks_effector.csv").read_text().startswith("t,u,v,std_u,std_v\n")


def test_unseen_colour_is_an_error_only_if_configured(tmp_path, robot, run_cli, capsys):
    (tmp_path / "robot.toml").write_text('[colours]\neffector = "magenta"\n')
    typed = ["estimate", robot / "reach.mcap", "--body", robot / "body.npz", "-o", tmp_path / "out.mcap"]
    named = [*typed, "--config", tmp_path / "robot.toml"]
    assert run_cli(*named) == 65
    last = capsys.readouterr().err.splitlines()[-1]
    assert "effector: 'magenta' was never found" in last
    assert "seen: green" in last
    assert "--without effector" in last
    assert not (tmp_path / "out.mcap").exists()
    assert run_cli(*named, "--without", "effector") == 0


@pytest.mark.parametrize("name", ["fit", "view", "estimate", "extract", "plot", "report", "layout", "ingest"])
def test_command_refuses_to_overwrite_its_inputs(tmp_path, capsys, run_cli, robot, name):
    log, body = tmp_path / "log.mcap", tmp_path / "body.npz"
    shutil.copy(robot / "reach.mcap", log)
    shutil.copy(robot / "body.npz", body)
    typed = ("--body", body) if name == "estimate" else ()
    for out in (log, body) if name == "estimate" else (log,):
        assert "is also an input" in _printed(capsys, 2, run_cli, name, log, *typed, "-o", out)
    assert log.read_bytes() == (robot / "reach.mcap").read_bytes()
    assert body.read_bytes() == (robot / "body.npz").read_bytes()

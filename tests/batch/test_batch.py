"""A folder of good and bad logs: every one has its row, and what is done is not done again."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from bodylog.batch.jobs import KEYS, name_logs, select_shard
from bodylog.batch.results import junit_xml
from bodylog.errors import LogError, UsageError, WriteError
from bodylog.findings import headline

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def mixed(tmp_path_factory, robot):
    """Good, truncated, empty, not a log; each in its place below one folder."""
    folder = tmp_path_factory.mktemp("mixed")
    good = (robot / "reach.mcap").read_bytes()
    (folder / "good.mcap").write_bytes(good)
    long = (robot / "explore.mcap").read_bytes()
    (folder / "truncated.mcap").write_bytes(long[: len(long) * 3 // 4])
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "noise.bag").write_bytes(bytes(range(256)) * 20)
    (folder / "notes.txt").write_text("not a log's name")
    return folder


def _rows(out):
    return {row["name"]: row for row in map(json.loads, (out / "results.jsonl").read_text().splitlines())}


def _tree(out):
    return {str(p.relative_to(out)): p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()}


def test_batch_has_a_row_per_log_and_the_worst_exit_code(tmp_path, mixed, robot, run_cli):
    assert run_cli("batch", mixed, "-o", tmp_path, "--body", robot / "body.npz", "--jobs", 2) == 65
    codes = {name: row["exit_code"] for name, row in _rows(tmp_path).items()}
    assert codes == {"good.mcap": 0, "truncated.mcap": 3, "empty.mcap": 65, "noise.bag": 65}
    assert "<title>good.mcap (annotated.mcap)</title>" in (tmp_path / "good.mcap" / "report.html").read_text()
    assert not (tmp_path / "empty.mcap" / "annotated.mcap").exists()


def test_junit_counts_failures_and_errors(tmp_path, mixed, robot, run_cli):
    run_cli("batch", mixed, "-o", tmp_path, "--body", robot / "body.npz", "--fail-if", "rmse/joint>1e-9")
    suite = ET.parse(tmp_path / "junit.xml").getroot()
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("4", "2", "2")


def test_junit_follows_the_schema(tmp_path, mixed, robot, run_cli):
    junitparser = pytest.importorskip("junitparser")
    run_cli("batch", mixed, "-o", tmp_path, "--body", robot / "body.npz", "--fail-if", "rmse/joint>1e-9")
    suite = next(iter(junitparser.JUnitXml.fromfile(str(tmp_path / "junit.xml"))))
    kinds = {case.name: [type(result).__name__ for result in case.result] for case in suite}
    broken, unusable = ["Failure"], ["Error"]
    assert kinds == {"good.mcap": broken, "truncated.mcap": broken, "empty.mcap": unusable, "noise.bag": unusable}
    if shutil.which("xmllint") is None:
        pytest.skip("xmllint is not installed: the schema was not checked")
    schema = ROOT / "fixtures" / "junit" / "junit-10.xsd"
    subprocess.run(["xmllint", "--noout", "--schema", schema, tmp_path / "junit.xml"], check=True, capture_output=True)


@pytest.mark.parametrize("problem", [WriteError("o: No space left on device"), OSError(errno.ENOSPC, "No space left")])
def test_full_disk_becomes_a_row_and_the_exit_code(tmp_path, monkeypatch, robot, run_cli, problem):
    def full(*_, **__):
        raise problem

    monkeypatch.setattr("bodylog.pipeline.estimate", full)
    out = tmp_path / "out"
    typed = ("batch", robot / "reach.mcap", "-o", out, "--body", robot / "body.npz", "--jobs", 1)
    assert run_cli(*typed) == 74
    (row,) = _rows(out).values()
    assert (row["exit_code"], row["status"]) == (74, "not written") and "No space left" in row["error"]
    assert 'errors="1"' in (out / "junit.xml").read_text()


def test_junit_replaces_control_characters():
    row = {"name": "a\x00<b>", "log": "a", "exit_code": 65, "status": "unusable", "error": "bad \x1b[0m & worse"}
    tree = ET.fromstring(junit_xml([{**row, "scores": {}, "findings": []}]).encode())
    assert tree.find(".//testcase").get("name") == "a\ufffd<b>"
    assert tree.find(".//error").get("message") == "bad \ufffd[0m & worse"


def test_file_name_that_is_not_utf8_has_a_row_and_is_resumed(tmp_path, robot, run_cli):
    odd, out = tmp_path / os.fsdecode(b"bad\xff.mcap"), tmp_path / "out"
    shutil.copy(robot / "reach.mcap", odd)
    typed = ("batch", odd, tmp_path / "gone" / ".." / odd.name, "-o", out, "--body", robot / "body.npz")
    (tmp_path / "gone").mkdir()
    assert run_cli(*typed) == 0
    before = {path: path.stat().st_mtime_ns for path in out.rglob("annotated.mcap")}
    assert len(before) == 2 and {row["log"] for row in _rows(out).values()} == {str(log) for log in typed[1:3]}
    assert run_cli(*typed, "--resume") == 0
    assert before == {path: path.stat().st_mtime_ns for path in before}


def test_results_among_the_logs_are_not_input(tmp_path, capsys, robot, run_cli):
    shutil.copy(robot / "reach.mcap", tmp_path / "reach.mcap")
    body, found = ("--body", robot / "body.npz"), []
    for where in (tmp_path, tmp_path, f"{tmp_path}/**/*.mcap"):
        assert run_cli("batch", where, "-o", tmp_path / "out", *body) == 0
        found.append(list(_rows(tmp_path / "out")))
    assert found == [["reach.mcap"]] * 3
    assert run_cli("batch", tmp_path / "out" / "reach.mcap" / "annotated.mcap", "-o", tmp_path / "more", *body) == 0
    before = _tree(tmp_path)
    for out, code in ((tmp_path, 2), (tmp_path / "reach.mcap", 73)):
        capsys.readouterr()
        assert run_cli("batch", tmp_path / "reach.mcap", "-o", out, *body) == code
        assert f"{tmp_path / 'reach.mcap'}" in capsys.readouterr().err
    assert _tree(tmp_path) == before


def test_resumed_batch_equals_an_uninterrupted_one_and_repeats_no_log(tmp_path, mixed, robot, run_cli):
    whole, resumed = tmp_path / "whole", tmp_path / "resumed"
    for out in (whole, resumed):
        run_cli("batch", mixed, "-o", out, "--body", robot / "body.npz")
    kept = (resumed / "good.mcap" / "annotated.mcap").stat().st_mtime_ns
    (resumed / "truncated.mcap" / "annotated.mcap").write_bytes(b"half")
    (resumed / "results.jsonl").unlink()
    run_cli("batch", mixed, "-o", resumed, "--body", robot / "body.npz", "--resume")
    assert _tree(resumed) == _tree(whole)
    assert (resumed / "good.mcap" / "annotated.mcap").stat().st_mtime_ns == kept


OLD = ({"scores": {"joint_rmse": 0.1, "nees": 1.0}}, {"verdict": None}, {"headline": {"faults": 1}}, {"scores": None})
"""Rows of other versions."""


@pytest.mark.parametrize("old", OLD)
def test_resume_repeats_a_log_whose_row_has_another_form(old, tmp_path, robot, run_cli):
    typed = ("batch", robot / "reach.mcap", "-o", tmp_path, "--body", robot / "body.npz")
    assert run_cli(*typed) == 0
    before, place = _tree(tmp_path), tmp_path / "reach.mcap" / "row.json"
    row = json.loads(place.read_text()) | old
    place.write_text(json.dumps({key: value for key, value in row.items() if value is not None}))
    assert run_cli(*typed, "--resume") == 0
    assert _tree(tmp_path) == before


def test_a_row_has_the_keys_that_resume_asks_for(tmp_path, robot, run_cli):
    assert run_cli("batch", robot / "reach.mcap", "-o", tmp_path, "--body", robot / "body.npz") == 0
    (row,) = _rows(tmp_path).values()
    assert set(row) == KEYS


def test_summary_begins_with_the_verdict_and_shows_what_a_report_does(tmp_path, mixed, robot, run_cli, capsys):
    run_cli("batch", mixed, "-o", tmp_path, "--body", robot / "body.npz")
    first, second, *_ = capsys.readouterr().out.splitlines()
    page = (tmp_path / "summary.html").read_text()
    assert f"<h1>4 logs</h1>\n<p>{first}</p>\n<p>{second}</p>\n<table>" in page
    assert first.startswith("4 logs: 2 unusable, 1 passed")
    names = [name for name in headline.NAMES if name != "error of the calibration alone"]  # of still poses
    heads = ("log", "status", *names, "remark")
    assert "".join(f"<th>{name}</th>" for name in heads) in page
    assert "free_energy" not in page and "log_evidence" not in page
    scored = next(row for row in _rows(tmp_path).values() if row["headline"])
    report = (tmp_path / scored["name"] / "report.html").read_text()
    for name, text in scored["headline"].items():
        assert f"<td>{text}</td>" in page and f"<div><b>{text}</b>{name}</div>" in report


def test_killed_batch_resumes_to_the_same_bytes(tmp_path, mixed, robot, run_cli):
    def wait_for_part(process, out):
        while process.poll() is None and not list(out.rglob(".*.part")):
            time.sleep(0.005)

    _killed_and_resumed(tmp_path, mixed, robot, run_cli, [wait_for_part])


@pytest.mark.soak
def test_batch_killed_twenty_times_resumes_to_the_same_bytes(tmp_path, mixed, robot, run_cli):
    waits = [lambda *_, seconds=0.2 + 0.2 * k: time.sleep(seconds) for k in range(20)]
    _killed_and_resumed(tmp_path, mixed, robot, run_cli, waits)


def _killed_and_resumed(tmp_path, mixed, robot, run_cli, waits):
    """The batch is killed after each wait, which is given its process and folder, and resumed."""
    typed = ["batch", str(mixed), "--body", str(robot / "body.npz"), "--jobs", "2", "--resume", "-o"]
    run_cli(*typed, tmp_path / "whole")
    whole = _tree(tmp_path / "whole")
    for number, wait in enumerate(waits):
        out = tmp_path / f"killed{number}"
        command = [sys.executable, "-m", "bodylog_cli", *typed, str(out)]
        process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
        wait(process, out)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        run_cli(*typed, out)
        assert _tree(out) == whole


@pytest.mark.soak
def test_killed_worker_is_replaced_and_its_log_finished(tmp_path, mixed, robot):
    command = [sys.executable, "-m", "bodylog_cli", "batch", str(mixed), "-o", str(tmp_path), "--jobs", "2"]
    process = subprocess.Popen([*command, "--body", str(robot / "body.npz")], stderr=subprocess.DEVNULL)
    killed = _kill_a_child(process)
    assert killed
    assert process.wait() == 65
    assert {name: row["exit_code"] for name, row in _rows(tmp_path).items()}["good.mcap"] == 0


def _kill_a_child(process):
    while process.poll() is None:
        children = subprocess.run(["pgrep", "-P", str(process.pid), "-f", "spawn_main"], capture_output=True, text=True)
        if children.stdout.split():
            os.kill(int(children.stdout.split()[0]), signal.SIGKILL)
            return True
        time.sleep(0.02)
    return False


def test_logs_are_in_the_order_of_their_numbers(tmp_path):
    """A camera that moved "from episode 9 on" is found in the order of recording."""
    for number in (10, 9, 1, 100):
        (tmp_path / f"run_{number}.mcap").touch()
    assert list(name_logs([str(tmp_path)])) == ["run_1.mcap", "run_9.mcap", "run_10.mcap", "run_100.mcap"]


def test_shards_cover_all_logs_once(tmp_path, mixed):
    names = name_logs([str(mixed)])
    assert sorted(name for i in (1, 2, 3) for name in select_shard(names, (i, 3))) == sorted(names)


def test_cyclic_links_are_followed_once(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x.mcap").touch()
    for name, to in (("self", "."), ("up", ".."), ("again", "../a")):
        (tmp_path / "a" / name).symlink_to(to)
    (tmp_path / "b").symlink_to("a")
    assert name_logs([str(tmp_path)]) == {"x.mcap": str(tmp_path / "a" / "x.mcap")}


def test_logs_with_the_same_name_get_different_folders(tmp_path, mixed):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        shutil.copy(mixed / "empty.mcap", tmp_path / folder)
    assert len(name_logs([str(tmp_path)])) == 2


@pytest.mark.parametrize(("logs", "shard", "text"), [(["none*"], (1, 1), "no such"), (["."], (3, 2), "runs from 1")])
def test_share_refuses_no_logs_and_impossible_shards(tmp_path, logs, shard, text):
    with pytest.raises((LogError, UsageError), match=text):
        select_shard(name_logs(logs), shard)


@pytest.mark.parametrize(
    ("typed", "code", "text"),
    [
        (("--fail-if", "rmse/joint"), 2, "not a bound"),
        (("--method", "x"), 2, "x"),
        (("--with", "smell"), 2, "smell"),
        (("--rate", "0"), 2, "rate"),
        (("--body", "none.npz"), 65, "none.npz: there is no such body model"),
    ],
)
def test_invalid_options_are_rejected_before_the_first_log(tmp_path, capsys, robot, run_cli, typed, code, text):
    body = () if "--body" in typed else ("--body", robot / "body.npz")
    capsys.readouterr()
    assert run_cli("batch", robot / "reach.mcap", "-o", tmp_path / "out", *body, *typed) == code
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and text in printed
    assert not list((tmp_path / "out").glob("*")), printed


def test_absent_training_log_is_an_error(tmp_path, capsys, robot, run_cli):
    assert run_cli("batch", robot / "reach.mcap", "-o", tmp_path, "--train", tmp_path / "none.mcap") == 65
    text = f"{tmp_path}/none.mcap: there is no such file or folder; check the name"
    assert capsys.readouterr().err == f"bodylog: {text}\n"


def test_pool_has_at_most_one_worker_per_log(tmp_path, monkeypatch, robot, run_cli):
    from bodylog.batch import local

    asked = []
    monkeypatch.setattr(local, "run_on_this_machine", lambda jobs, workers, *_: asked.append((len(jobs), workers)) or [])
    logs = robot / "reach.mcap", robot / "explore.mcap"
    run_cli("batch", *logs, "-o", tmp_path, "--body", robot / "body.npz", "--jobs", 64)
    assert asked == [(2, 2)]

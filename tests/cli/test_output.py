"""What names in a log may hold is printed, not obeyed."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from bodylog_cli import output

from tests.logs.writing import T0, camera, compressed, joint_state, joints, write

EVIL = "\x1b[2J\x1b]0;title\x07\nbodylog: all is well"


def test_output_escapes_control_characters_in_names(tmp_path: Path, capsys, monkeypatch, run_cli) -> None:
    import click

    monkeypatch.setattr(click.utils, "should_strip_ansi", lambda *_: False)  # as on a terminal
    rows = [(T0 + k * 10**7, joint_state(T0 + k * 10**7, ("a", EVIL), (0.1 * k, 0.0))) for k in range(20)]
    seen = [(T0 + k * 10**7, compressed(T0 + k * 10**7, np.zeros((8, 8, 3), np.uint8))) for k in range(20)]
    log = write(tmp_path / "x.mcap", [joints(f"/joints{EVIL}", rows), camera(f"/cam{EVIL}", seen)])
    for typed in (("info", log), ("doctor", log), ("plot", log, "-o", tmp_path / "x.png"), ("fit", log, "-o", "b.npz")):
        capsys.readouterr()
        run_cli(*typed)
        printed = "".join(capsys.readouterr())
        assert not [c for c in printed if c != "\n" and not c.isprintable()]
        assert not [line for line in printed.splitlines() if line.startswith("bodylog: all is well")]
    run_cli("info", log)
    assert "\\x1b[2J" in capsys.readouterr().out


def test_files_may_be_called_anything(tmp_path: Path, capsys, run_cli) -> None:
    """Bytes that are no UTF-8, and signs that a terminal obeys."""
    folder = tmp_path / "\udcff\n%s"
    folder.mkdir()
    rows = [(T0 + k * 10**7, joint_state(T0 + k * 10**7, ("a",), (0.1 * k,))) for k in range(20)]
    log = write(folder / "x\udcfe.mcap", [joints("/joints", rows)])
    capsys.readouterr()
    tables = ("--csv", folder / "csv\udcff", "--parquet", folder / "parquet\udcff")
    assert run_cli("ingest", log, "-o", folder / "out\n.mcap", *tables) == 0
    assert capsys.readouterr().err.splitlines()[-1] == f"wrote {tmp_path}/\\udcff\\n%s/out\\n.mcap"
    assert {file.name for file in folder.rglob("joints.*")} == {"joints.csv", "joints.parquet"}


def test_folder_option_refuses_a_file_before_writing(tmp_path: Path, capsys, run_cli) -> None:
    taken = write(tmp_path / "x.mcap", [joints("/joints", [(T0, joint_state(T0, ("a",), (0.1,)))])])
    for typed in (("ingest", "--csv", taken), ("extract", "--csv", taken / "in"), ("report", "--figures", taken)):
        assert run_cli(typed[0], taken, "-o", tmp_path / "out", *typed[1:]) == 73
        assert "is a file; type a folder name" in capsys.readouterr().err
        assert [*tmp_path.iterdir()] == [taken]


def test_full_standard_error_keeps_the_exit_code(tmp_path: Path) -> None:
    """/dev/full takes nothing: as a terminal that is gone."""
    command = [sys.executable, "-m", "bodylog_cli", "info"]
    for typed, code in ((tmp_path / "absent", 65), ("--unknown", 2)):
        with open("/dev/full", "w") as full:
            assert subprocess.run([*command, str(typed)], stderr=full, timeout=60).returncode == code


def test_names_that_an_output_cannot_write_are_printed_as_codes(tmp_path: Path) -> None:
    rows = [(T0 + k * 10**7, joint_state(T0 + k * 10**7, ("ä", "🤖"), (0.1 * k, 0.0))) for k in range(20)]
    log = write(tmp_path / "x.mcap", [joints("/joints", rows)])
    command = [sys.executable, "-m", "bodylog_cli", "info", str(log)]
    done = subprocess.run(command, capture_output=True, env={**os.environ, "PYTHONIOENCODING": "latin-1"}, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "joint names: ä, \\U0001f916" in done.stdout.decode("latin-1")


def test_data_prints_numbers_that_are_not_finite_as_null(capsys) -> None:
    output.print_json([{"a": np.array([[1.0, np.nan], [np.inf, 2.0]]), "b": np.float64("nan"), "c": Path("x")}])
    found = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert found["results"] == [{"a": [[1.0, None], [None, 2.0]], "b": None, "c": "x"}]


def test_standard_output_on_a_full_disk_is_an_output_that_cannot_be_written() -> None:
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "bodylog_cli", "config"]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (74, "bodylog: output: No space left on device\n")


def test_estimate_prints_eight_lines_none_with_q_and_information_with_v(tmp_path, capsys, run_cli, robot) -> None:
    typed = ("estimate", robot / "reach.mcap", "--body", robot / "body.npz", "-o", tmp_path / "out.mcap")
    capsys.readouterr()
    assert run_cli(*typed) == 0
    plain = capsys.readouterr()
    assert plain.out.startswith("no fault found in ") and "error (RMSE) " in plain.out
    assert len([*plain.out.splitlines(), *plain.err.splitlines()]) <= 8 and "info: " not in plain.err
    assert run_cli(*typed, "-q") == 0
    assert capsys.readouterr() == ("", "")
    assert run_cli(*typed, "-v") == 0
    verbose = capsys.readouterr()
    assert verbose.out == plain.out and "info: " in verbose.err
    assert run_cli(*typed, "--all") == 0
    assert "rmse/joint " in capsys.readouterr().out.removeprefix(plain.out)


def test_many_logs_evaluated_are_a_table_with_a_row_for_each(tmp_path, capsys, run_cli, robot) -> None:
    logs = [tmp_path / "a.mcap", tmp_path / "longer.mcap"]
    for log in logs:
        assert run_cli("estimate", robot / "reach.mcap", "--body", robot / "body.npz", "-o", log) == 0
    capsys.readouterr()
    assert run_cli("evaluate", *logs) == 0
    head, units, *rows = capsys.readouterr().out.splitlines()
    assert head.split() == ["log", "rmse/joint", "rmse/encoders", "nees/joint", "coverage_2sigma/joint", "faults"]
    assert units.split() == ["rad", "rad", "1", "%", "1"] and [row.split()[0] for row in rows] == [*map(str, logs)]
    assert len({len(row) for row in (head, *rows)}) == 1


def test_fault_is_printed_once(capsys) -> None:
    from bodylog.findings.faults import fault_warnings
    from bodylog.pipeline import Result
    from bodylog.types import Fault, FaultKind

    fault = Fault("encoders", "elbow", FaultKind.DRIFTING, 8.8, 0.3, "rad")
    verdict, findings = ("elbow: encoder drifts",), fault_warnings([fault])
    output.print_result(Result(None, findings=findings, faults=(fault,), verdict=verdict), "x", False)
    assert capsys.readouterr() == ("elbow: encoder drifts\n", "")
    output.print_result(Result(None, findings=findings, faults=(fault,)), "x", False)
    assert capsys.readouterr().err.startswith("warning: encoders elbow: drifting")


def test_help_lists_every_command_once_with_its_whole_summary(capsys, run_cli) -> None:
    from bodylog_cli.commands import GROUPS, bodylog

    assert run_cli("--help") == 0
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert [name for commands in GROUPS.values() for name in commands] == list(bodylog.commands)
    for name, command in bodylog.commands.items():
        assert command.name == name
        summary = command.get_short_help_str(limit=200)
        assert len(summary) < 55 and "..." not in summary
        assert any(line.split(maxsplit=1) == [command.name, summary] for line in lines), command.name


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("bodylog est", {"estimate"}),
        ("bodylog estimate --method ", {"filter", "smoother", "ekf", "kalman", "predictive-coding"}),
        ("bodylog estimate --prec", {"--precision"}),
    ],
)
def test_shell_completes_commands_options_and_choices(words: str, expected: set[str]) -> None:
    asked = {"_BODYLOG_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    command = [sys.executable, "-c", "import bodylog_cli; bodylog_cli.main()"]
    done = subprocess.run(command, env={**os.environ, **asked}, capture_output=True, text=True, timeout=60)
    assert (done.returncode, {line.partition(",")[2] for line in done.stdout.splitlines()}) == (0, expected)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_documented_completion_lines_give_a_script(shell: str) -> None:
    page = (Path(__file__).parents[2] / "docs" / "cli.md").read_text()
    assert f"_BODYLOG_COMPLETE={shell}_source bodylog" in page
    command = [sys.executable, "-c", "import bodylog_cli; bodylog_cli.main()"]
    environment = {**os.environ, "_BODYLOG_COMPLETE": f"{shell}_source"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and f"_BODYLOG_COMPLETE={shell}_complete" in done.stdout


def test_bars_end_at_their_totals(robot, tmp_path, monkeypatch, run_cli):
    """Of commands that count steps, or images that they write."""
    from rich.progress import Progress

    totals, done = list[float](), list[float]()

    def added(_self: Progress, _text: str, total: float) -> int:
        totals.append(total)
        return 0

    monkeypatch.setattr(Progress, "add_task", added)
    monkeypatch.setattr(Progress, "advance", lambda _self, _task, more: done.append(more))
    log = tmp_path / "annotated.mcap"
    assert run_cli("estimate", robot / "reach.mcap", "--body", robot / "body.npz", "-o", log) == 0
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    commands = {("report", log, "-o", tmp_path / "page.html"): 3}
    if find_spec("rerun_cli"):
        commands["view", log, "-o", tmp_path / "log.rrd"] = 4
    if find_spec("av") and find_spec("pyarrow"):
        commands["convert", robot / "reach.mcap", "-o", tmp_path / "set", "--to", "lerobot"] = 80
    for command, total in commands.items():
        totals.clear(), done.clear()
        assert run_cli(*command) == 0
        assert totals == [total] == [sum(done)], command

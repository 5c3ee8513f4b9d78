"""A batch into a folder of other logs is refused, and files between two runs may hold anything."""

import json
import shutil

import pytest

from bodylog.batch import folders, resume
from bodylog.batch.jobs import Job
from bodylog.batch.results import Journal
from bodylog.errors import UsageError
from bodylog.settings import Settings


@pytest.fixture
def two(tmp_path, robot):
    """Folders a and b, each with a log."""
    for name in "ab":
        (tmp_path / name).mkdir()
        shutil.copy(robot / "reach.mcap", tmp_path / name / f"{name}.mcap")
    return tmp_path


def _names(out):
    return [json.loads(line)["name"] for line in (out / "results.jsonl").read_text().splitlines()]


def test_batch_refuses_a_folder_of_other_logs(two, robot, run_cli, capsys):
    typed = ("--body", robot / "body.npz", "-o", two / "out")
    assert run_cli("batch", two / "a", *typed) == 0
    assert run_cli("batch", two / "b", *typed) == 2
    printed = capsys.readouterr().err.strip().splitlines()[-1]
    assert printed.startswith(f"bodylog: {two / 'out'}: it holds the results of 1 logs") and "a.mcap" in printed
    assert _names(two / "out") == ["a.mcap"]
    assert run_cli("batch", two / "a", two / "b", *typed) == 0
    assert _names(two / "out") == ["a.mcap", "b.mcap"]


def test_claim_refuses_another_log_of_the_same_name(tmp_path):
    folders.mark_folder(tmp_path, folders.BATCH)
    log, other = tmp_path / "x" / "run.mcap", tmp_path / "y" / "run.mcap"
    for path in (log, other):
        path.parent.mkdir()
        path.touch()
    folders.claim_folder(tmp_path, {"run.mcap": str(log)})
    folders.claim_folder(tmp_path, {"run.mcap": str(log)})
    with pytest.raises(UsageError, match="it holds the results of 1 logs that this batch does not name"):
        folders.claim_folder(tmp_path, {"run.mcap": str(other)})
    log.rename(tmp_path / "moved.mcap")
    folders.claim_folder(tmp_path, {"run.mcap": str(other)})


def test_journal_leaves_the_rows_to_a_batch_of_more_logs(tmp_path):
    folders.mark_folder(tmp_path, folders.BATCH)
    one = Job("a", "a", tmp_path / "a", tmp_path, Settings(), (), False, "how")
    folders.claim_folder(tmp_path, {"a": "a"})
    journal = Journal(tmp_path, [one], frozenset("a"), {})
    (tmp_path / "results.jsonl").write_text('{"name": "b"}\n')
    folders.claim_folder(tmp_path, {"a": "a", "b": "b"})
    journal.add({"name": "a"})
    journal.finish()
    assert _names(tmp_path) == ["b"]


@pytest.mark.parametrize("text", ["[" * 100_000, "5", '{"outputs": 5}', '{"outputs": {"robot.toml": []}}', "\0"])
def test_finished_ignores_a_row_that_is_none(tmp_path, text):
    job = Job("a", "a", tmp_path, tmp_path, Settings(), (), True, "how")
    (tmp_path / folders.ROW).write_text(text)
    assert resume.read_finished_row(job) is None and resume.read_valid_row(job) is None


def test_finished_ignores_a_row_whose_values_are_of_other_kinds(tmp_path, robot, run_cli):
    typed = ("batch", robot / "reach.mcap", "--body", robot / "body.npz", "-o", tmp_path)
    assert run_cli(*typed) == 0
    path = tmp_path / "reach.mcap" / folders.ROW
    row = json.loads(path.read_text())
    for name in ("outputs", "scores", "verdict", "exit_code"):
        path.write_text(json.dumps(row | {name: "x"}))
        assert run_cli(*typed, "--resume") == 0
        assert json.loads(path.read_text()) == row

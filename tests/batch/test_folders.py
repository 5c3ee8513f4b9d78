"""A batch writes only into folders that it made and marked, alone or beside its shards."""

import json
import shutil
import subprocess
import sys

import pytest

from bodylog.batch import folders, jobs, resume
from bodylog.batch.jobs import KEYS, Job, find_logs, name_logs
from bodylog.batch.results import Journal
from bodylog.errors import UsageError
from bodylog.settings import Settings
from tests.work import at_most


def _tree(out):
    return {str(p.relative_to(out)): p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()}


def _rosbag2(folder):
    folder.mkdir(parents=True)
    (folder / "run_0.db3").write_bytes(b"precious")
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    (folder / "robot.toml").write_text("# by hand\n")
    return folder


def _refused(capsys, run_cli, folder, *typed):
    before = _tree(folder)
    capsys.readouterr()
    assert run_cli("batch", *typed) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and _tree(folder) == before
    return error


def test_log_inside_the_output_folder_is_rejected(tmp_path, capsys, run_cli, robot):
    run = _rosbag2(tmp_path / "runs" / "run1")
    error = _refused(capsys, run_cli, tmp_path, run, "--body", robot / "body.npz", "-o", run.parent)
    assert f"holds an input ({run})" in error


def test_folder_of_others_is_not_written_to(tmp_path, capsys, run_cli, robot):
    theirs = _rosbag2(tmp_path / "out" / "reach.mcap")
    typed = (robot / "reach.mcap", "--body", robot / "body.npz", "-o", tmp_path / "out")
    assert f"{theirs}: no batch made this folder" in _refused(capsys, run_cli, tmp_path, *typed)
    shutil.rmtree(theirs)
    theirs.symlink_to(_rosbag2(tmp_path / "elsewhere"))
    assert f"{theirs}: no batch made this folder" in _refused(capsys, run_cli, tmp_path, *typed)


@pytest.mark.parametrize("name", ["results.jsonl", "junit.xml", "summary.html"])
def test_summary_of_others_is_not_replaced(tmp_path, capsys, run_cli, robot, name):
    (tmp_path / name).write_text("<testsuites name='of other tests'/>")
    error = _refused(capsys, run_cli, tmp_path, robot / "reach.mcap", "--body", robot / "body.npz", "-o", tmp_path)
    assert f"{tmp_path / name}: no batch wrote this file" in error


@pytest.mark.parametrize("name", ["body.npz", "body.json"])
def test_body_of_others_is_not_replaced(tmp_path, capsys, run_cli, robot, name):
    (tmp_path / name).write_bytes(b"the user's")
    error = _refused(capsys, run_cli, tmp_path, robot / "reach.mcap", "--train", robot / "explore.mcap", "-o", tmp_path)
    assert f"{tmp_path / name}: no batch " in error and "--train would replace it" in error


def test_body_of_a_batch_is_replaced_even_if_it_was_killed_while_learning(tmp_path):
    body, mark = tmp_path / "body.npz", tmp_path / "body.json"
    resume.check_replaceable(body)
    body.write_bytes(b"learned")
    for known in (None, "0" * 64):
        mark.write_text(json.dumps(["wanted", known]))
        if known is None:
            resume.check_replaceable(body)
            continue
        with pytest.raises(UsageError, match="no batch learned this body"):
            resume.check_replaceable(body)


def test_results_of_earlier_versions_are_resumed_and_repaired(tmp_path, run_cli, robot):
    """They marked a folder with a lock alone, now and then a recording; its log is found again."""
    out, typed = tmp_path / "out", ("batch", robot / "reach.mcap", "--body", robot / "body.npz", "--resume", "-o")
    assert run_cli(*typed, out) == 0
    whole, result = _tree(out), out / "reach.mcap"
    (out / folders.BATCH).unlink()
    (result / folders.RESULT).rename(result / ".lock")
    row = json.loads((result / "row.json").read_text())
    del row["how"]
    (result / "row.json").write_text(json.dumps(row, sort_keys=True))
    kept = (result / "annotated.mcap").stat().st_mtime_ns
    assert list(find_logs(str(tmp_path / "out"))) == []
    assert run_cli(*typed, out) == 0
    assert _tree(out) == whole and (result / "annotated.mcap").stat().st_mtime_ns == kept
    run = _rosbag2(tmp_path / "runs" / "run1")
    for name in (".lock", "row.json", "annotated.mcap", "report.html"):
        (run / name).touch()
    assert list(find_logs(str(tmp_path / "runs"))) == [str(run)]


def test_logs_in_a_folder_with_results_are_still_found(tmp_path, run_cli, robot):
    """The folder given with -o may hold other things, which stay."""
    (tmp_path / "later").mkdir()
    shutil.copy(robot / "reach.mcap", tmp_path / "later" / "b.mcap")
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "reach.mcap").mkdir()
    assert run_cli("batch", robot / "reach.mcap", "--body", robot / "body.npz", "-o", tmp_path) == 0
    assert name_logs([str(tmp_path)]) == {"b.mcap": str(tmp_path / "later" / "b.mcap")}
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_names_equal_on_some_file_systems_get_different_folders():
    logs = {"a/Run.mcap": "Run.mcap", "b/run.MCAP": "run.MCAP", "c/x.mcap": "x.mcap", "d": "junit.xml", "e": "y" * 250}
    found = folders.name_folders(logs)
    assert found["c/x.mcap"] == "x.mcap" and len({name.casefold() for name in found.values()}) == 5
    assert "junit.xml" not in found.values() and max(map(len, found.values())) < 255


LOCKLESS = """
import errno, fcntl, sys
def flock(*_):
    raise OSError(errno.ENOLCK, "No locks available")
if sys.argv.pop(1) == "lockless":
    fcntl.flock = flock
import bodylog_cli
bodylog_cli.main()
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory, robot, run_cli):
    """Logs good and bad, and what one batch over all of them leaves."""
    folder = tmp_path_factory.mktemp("runs")
    (folder / "logs").mkdir()
    shutil.copy(robot / "reach.mcap", folder / "logs" / "c.mcap")
    for name in "abde":
        (folder / "logs" / f"{name}.mcap").write_bytes(b"no log")
    assert run_cli("batch", folder / "logs", "--body", robot / "body.npz", "-o", folder / "whole") == 65
    return folder


@pytest.mark.parametrize("how", ["locks", "lockless"])
def test_shards_in_one_folder_leave_the_files_of_one_run(tmp_path, runs, robot, how):
    shards = [_shard(runs, robot, tmp_path / "out", how, f"{i}/3") for i in (1, 2, 3)]
    assert [shard.wait(timeout=120) for shard in shards] == [65, 65, 0]
    assert _tree(tmp_path / "out") == _tree(runs / "whole")


def _shard(runs, robot, out, how, part):
    typed = ("batch", runs / "logs", "--body", robot / "body.npz", "-o", out, "--shard", part)
    return subprocess.Popen([sys.executable, "-c", LOCKLESS, how, *map(str, typed)], stderr=subprocess.DEVNULL)


def test_sequential_shards_show_finished_rows(tmp_path, runs, robot, run_cli):
    """Rows of other settings, which a later shard is to replace, are left out until then."""
    out, typed = tmp_path / "out", ("batch", runs / "logs", "--body", robot / "body.npz", "-o")
    bad = ("--fail-if", "rmse/joint>9")
    for part, names in (("1/3", "ad"), ("3/3", "cad")):
        run_cli(*typed, out, "--shard", part, *(() if part == "3/3" else bad))
        if part == "1/3":
            assert _names(out) == [f"{name}.mcap" for name in names]
    assert _names(out) == ["c.mcap"]
    for part in ("1/3", "2/3"):
        run_cli(*typed, out, "--shard", part)
    assert _tree(out) == _tree(runs / "whole")


def _names(out):
    return [json.loads(line)["name"] for line in (out / "results.jsonl").read_text().splitlines()]


def test_partial_row_of_a_killed_shard_is_removed(tmp_path):
    folders.mark_folder(tmp_path, folders.BATCH)
    three = [Job(name, name, tmp_path / name, tmp_path, Settings(), (), False, "how") for name in "abc"]
    empty = {"log": "a", "status": "passed", "exit_code": 0, "outputs": {}, "scores": {}, "used": {}, "health": {}}
    empty |= {"verdict": [], "headline": {}, "faults": [], "findings": []}
    rows = {job.name: {**dict.fromkeys(KEYS), **empty, "name": job.name} for job in three}
    own: dict = {}
    journal = Journal(tmp_path, three, frozenset("ab"), own)
    own["a"] = rows["a"]
    journal.add(rows["a"])
    with (tmp_path / "results.jsonl").open("a") as stream:
        stream.write('{"name": "c", "outp')
    folders.mark_folder(three[2].folder, folders.RESULT)
    resume.write_row(three[2], rows["c"])
    own["b"] = rows["b"]
    journal.add(rows["b"])
    assert _names(tmp_path) == ["a", "b", "c"]


def test_endless_search_is_rejected(tmp_path, monkeypatch):
    """Patterns that go down again and again, and folders too many or too deep for a search that calls itself."""
    deep = tmp_path.joinpath(*"d" * 400)
    deep.mkdir(parents=True)
    (deep / "a.mcap").touch()
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(350)
    try:
        assert list(find_logs(str(tmp_path))) == [str(deep / "a.mcap")]
    finally:
        sys.setrecursionlimit(limit)
    (tmp_path / "below" / "1/2/3/4/5/6/7/8/9/10").mkdir(parents=True)
    (tmp_path / "below" / "a.mcap").touch()
    with at_most(calls=100_000):
        assert list(find_logs(f"{tmp_path}/below/{'**/' * 12}a.mca?")) == [str(tmp_path / "below" / "a.mcap")]
    with pytest.raises(UsageError, match="goes back"):
        list(find_logs(f"{tmp_path}/*/../*/../a.mcap"))
    monkeypatch.setattr(jobs, "MOST", 10)
    for given in (str(tmp_path), f"{tmp_path}/**"):
        with pytest.raises(UsageError, match="more than 10"):
            list(find_logs(given))


def test_database_among_other_logs_is_one_log_of_a_folder(tmp_path):
    for name in ("one.db3", "two.mcap", "three.bag"):
        (tmp_path / name).write_bytes(b"log")
    assert list(find_logs(str(tmp_path))) == [str(tmp_path / name) for name in ("one.db3", "three.bag", "two.mcap")]
    (tmp_path / "two.mcap").unlink()
    (tmp_path / "three.bag").unlink()
    assert list(find_logs(str(tmp_path))) == [str(tmp_path)]


def test_logs_in_a_folder_are_found_whatever_the_case_of_their_suffix(tmp_path):
    for name in ("a.mcap", "B.MCAP", "c.Bag", "notes.TXT"):
        (tmp_path / name).touch()
    assert [log.rpartition("/")[2] for log in find_logs(str(tmp_path))] == ["B.MCAP", "a.mcap", "c.Bag"]


def test_a_log_in_capitals_is_no_part_of_the_database_beside_it(tmp_path):
    for name in ("one.db3", "TWO.MCAP"):
        (tmp_path / name).write_bytes(b"log")
    assert sorted(find_logs(str(tmp_path))) == [str(tmp_path / name) for name in ("TWO.MCAP", "one.db3")]

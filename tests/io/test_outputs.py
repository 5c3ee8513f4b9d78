"""No command writes to what it reads, by whatever name: every command of the table, every output, every input."""

import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import click
import pytest
from bodylog_cli.commands import bodylog
from bodylog_cli.options import Folder, NamedPath, OutputFile, Searched

from bodylog.checks import require_distinct_paths
from bodylog.errors import UsageError
from bodylog.io import outputs
from bodylog.io.outputs import Output, guard_outputs
from bodylog.settings import Settings
from bodylog.sources import TableSource


def _is_output(param):
    return isinstance(param.type, OutputFile | Folder)


def _is_input(param):
    return isinstance(param.type, NamedPath) and not _is_output(param)


PAIRS = [
    (command, read, written)
    for command in bodylog.commands.values()
    for written in filter(_is_output, command.params)
    for read in filter(_is_input, command.params)
]
IDS = [f"{command.name} {read.name} {written.name}" for command, read, written in PAIRS]


def test_output_options_have_an_output_type():
    """So that the guard knows it; a new command whose output has another type fails here."""
    wrong = []
    for command in bodylog.commands.values():
        for param in command.params:
            shown, place = str(getattr(param, "help", "")).lower(), str(param.metavar).lower()
            writes = {"-o", "--output"} & set(param.opts) or "write" in shown or "draw" in shown or "out." in place
            if writes and not _is_output(param):
                wrong.append((command.name, param.opts))
            if isinstance(param.type, click.Path) and not isinstance(param.type, NamedPath):
                wrong.append((command.name, param.opts))
    assert not wrong, wrong
    assert {command.name for command, *_ in PAIRS} >= {
        *("ingest", "doctor", "colours", "extract", "fit", "estimate", "plot", "report", "layout", "view", "batch")
    }


def _typed(command, read, written, source, out, spare):
    """A command line that reads `source` by one option and writes `out` by another; the rest names spare files."""
    words = [command.name]
    for param in command.params:
        given = {read.name: source, written.name: out}.get(param.name)
        if given is None and (param.required or (param.name == "body" and command.name == "batch")):
            given = spare.with_name(f"spare-{param.name}") if _is_output(param) else spare
        if given is not None:
            words += [given] if isinstance(param, click.Argument) else [param.opts[0], given]
    return words


def _link(target, folder):
    (folder / "link").symlink_to(target)
    return folder / "link"


def _hard_link(target, folder):
    os.link(target, folder / "hard")
    return folder / "hard"


def _roundabout(target, folder):
    (folder / "deep").mkdir()
    return folder / "deep" / ".." / target.name


FILES = {"itself": lambda target, _: target, "link": _link, "hard link": _hard_link, "..": _roundabout}


def _tree(folder):
    return {path: path.is_symlink() or path.is_dir() or path.read_bytes() for path in folder.rglob("*")}


def _refused(capsys, run_cli, folder, words):
    before = _tree(folder)
    capsys.readouterr()
    assert run_cli(*words) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and " input" in printed and "choose " in printed, printed
    assert _tree(folder) == before


@pytest.mark.parametrize("way", FILES)
@pytest.mark.parametrize(("command", "read", "written"), PAIRS, ids=IDS)
def test_output_equal_to_an_input_is_refused(tmp_path, capsys, run_cli, command, read, written, way):
    source, spare = tmp_path / "source.mcap", tmp_path / "spare"
    source.write_bytes(b"precious")
    spare.write_bytes(b"spare")
    if isinstance(written.type, Folder):  # what is given holds the input, or a link to it
        folder = tmp_path / "folder"
        folder.mkdir()
        out, source = folder, source.rename(folder / source.name) if way in ("itself", "..") else source
        if way in ("link", "hard link"):
            FILES[way](source, folder)
    else:
        out = FILES[way](source, tmp_path)
    _refused(capsys, run_cli, tmp_path, _typed(command, read, written, source, out, spare))


@pytest.mark.parametrize("name", ["run_0.db3", "metadata.yaml", "new.mcap", "deep/new.mcap"])
@pytest.mark.parametrize(("command", "read", "written"), PAIRS, ids=IDS)
def test_output_in_an_input_folder_is_refused(tmp_path, capsys, run_cli, command, read, written, name):
    spare = tmp_path / "spare"
    spare.write_bytes(b"spare")
    source = _rosbag2(tmp_path / "run")
    (source / "deep").mkdir()
    out = source / name
    if isinstance(written.type, Folder):
        out = source if name == "metadata.yaml" else source / "deep" / name.replace(".", "")
    _refused(capsys, run_cli, tmp_path, _typed(command, read, written, source, out, spare))


def _rosbag2(folder):
    """As much of a rosbag2 folder as its names are."""
    folder.mkdir()
    with closing(sqlite3.connect(folder / "run_0.db3")) as store, store:
        store.execute("CREATE TABLE messages (id INTEGER)")
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {relative_file_paths: [run_0.db3]}\n")
    return folder


def test_output_refuses_every_file_of_a_recording(tmp_path):
    """Named by one of them, or holding links to files elsewhere; other names beside a file are free."""
    run = _rosbag2(tmp_path / "run")
    elsewhere = tmp_path / "elsewhere" / "run_1.db3"
    elsewhere.parent.mkdir()
    elsewhere.touch()
    (run / "run_1.db3").symlink_to(elsewhere)
    (run / "more").symlink_to(elsewhere.parent)
    for out in (run / "metadata.yaml", run / "run_1.db3", elsewhere, run / "run_0.db3-wal"):
        with pytest.raises(UsageError, match="of an input"):
            guard_outputs([run / "run_0.db3"], [Output(out)])
    guard_outputs([run / "run_0.db3"], [Output(run / "tidy.mcap")])
    for out in (elsewhere, elsewhere.parent / "new.mcap", run / "more" / "new.mcap"):
        with pytest.raises(UsageError, match=r"of an input|inside an input"):
            guard_outputs([run], [Output(out)])
    for folder in (elsewhere.parent, tmp_path):
        with pytest.raises(UsageError, match=r"of an input|holds an input"):
            guard_outputs([run], [Output(folder, "--csv", folder=True)])
    guard_outputs([run], [Output(tmp_path / "run.mcap"), Output(tmp_path / "tables", "--csv", folder=True)])


def test_names_that_differ_in_case_alone_are_one_where_the_disk_says_so(tmp_path, monkeypatch):
    """Stood in for by a disk that ignores case: what a name leads to is asked of the disk."""
    run, stat = _rosbag2(tmp_path / "run"), os.stat
    monkeypatch.setattr(os, "stat", lambda path, **how: stat(os.fspath(path).lower().replace("é", "e"), **how))
    monkeypatch.setattr(outputs.os.path, "realpath", os.path.abspath)
    if outputs.path_identity(tmp_path) is None:
        pytest.skip("the tests' folder itself has capitals in its name")
    for out in (tmp_path / "RUN" / "new.mcap", tmp_path / "Run" / "Run_0.DB3", tmp_path / "RUN"):
        with pytest.raises(UsageError, match="input"):
            guard_outputs([run], [Output(out)])
    guard_outputs([run], [Output(tmp_path / "RUN2.mcap")])


def test_output_refuses_a_video_from_the_settings(tmp_path, capsys, run_cli, robot):
    shutil.copy(robot / "reach.mcap", tmp_path / "reach.mcap")
    (tmp_path / "side.avi").write_bytes(b"precious")
    (tmp_path / "robot.toml").write_text('[topics]\ncamera = "side.avi"\n')
    for name in ("extract", "ingest", "plot", "colours", "view"):
        typed = (name, tmp_path / "reach.mcap", "--config", tmp_path / "robot.toml", "-o", tmp_path / "side.avi")
        _refused(capsys, run_cli, tmp_path, typed)


def test_output_refuses_a_table_from_the_settings(tmp_path):
    settings = Settings(features={"finger": TableSource("tracks.csv")})
    (tmp_path / "tracks.csv").touch()
    with pytest.raises(UsageError, match="is also an input"):
        require_distinct_paths([tmp_path / "run.mcap"], [Output(tmp_path / "tracks.csv")], settings)


def test_output_refuses_a_file_url_of_an_input(tmp_path, capsys, run_cli, robot):
    pytest.importorskip("fsspec", reason="the cloud extra is not installed")
    log = tmp_path / "reach.mcap"
    shutil.copy(robot / "reach.mcap", log)
    _refused(capsys, run_cli, tmp_path, ("ingest", f"file://{log}", "-o", log))
    _refused(capsys, run_cli, tmp_path, ("batch", f"file://{log}", "--body", robot / "body.npz", "-o", tmp_path))


def test_outputs_of_one_path_are_refused(tmp_path, capsys, run_cli, robot):
    out = tmp_path / "out"
    for folder in (out, out / "tables"):
        assert run_cli("ingest", robot / "reach.mcap", "-o", out, "--csv", folder) == 2
        assert "are the same; give each" in capsys.readouterr().err and not out.exists()


@pytest.mark.parametrize("place", ["folder", "folder/", "pipe", "no/out.mcap", "out.mcap/", "loop", "/dev/full", "."])
def test_unwritable_output_is_refused_before_reading(tmp_path, capsys, run_cli, monkeypatch, place):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    monkeypatch.chdir(tmp_path)
    for name in ("ingest", "plot", "colours", "layout"):
        capsys.readouterr()
        assert run_cli(name, "absent.mcap", "-o", place) == 73
        assert capsys.readouterr().err.count("\n") == 1
    assert sorted(os.listdir(tmp_path)) == ["folder", "loop", "pipe"]


def test_output_refuses_a_stream_as_a_device(capsys, run_cli):
    """What /dev/stdout leads to, where that is a pipe, has no name."""
    read, write = os.pipe()
    assert run_cli("ingest", "absent.mcap", "-o", f"/dev/fd/{write}") == 73
    assert "is a device" in capsys.readouterr().err
    os.close(read)
    os.close(write)


def test_searched_folders_are_no_inputs_but_their_logs_are(tmp_path, capsys, run_cli, robot):
    shutil.copy(robot / "reach.mcap", tmp_path / "reach.mcap")
    body = ("--body", robot / "body.npz")
    _refused(capsys, run_cli, tmp_path, ("batch", tmp_path, *body, "-o", tmp_path))
    _refused(capsys, run_cli, tmp_path, ("batch", f"{tmp_path}/*.mcap", *body, "-o", tmp_path))
    assert Searched().convert("a*", None, None) == "a*" and Path("a*") != "a*"


def test_images_that_a_table_of_poses_names_are_inputs(tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "a.png").write_bytes(b"\x89PNG")
    (tmp_path / "poses.csv").write_text("elbow,image\n0.1,images/a.png\n")
    with pytest.raises(UsageError, match="also an input"):
        require_distinct_paths([tmp_path / "poses.csv"], [Output(tmp_path / "images" / "a.png")], Settings())

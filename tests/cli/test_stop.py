"""Commands that cannot go on, as processes of their own: what they began is gone, what was there stays."""

import os
import resource
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

COMMAND = (sys.executable, "-m", "bodylog_cli")


def _command(*typed):
    return [*COMMAND, *map(str, typed)]


@contextmanager
def _begun(typed):
    """A command that hears signals, also where these tests run in the background or under nohup, which ignore some.

    One that does not end when it should ends with the test, together with all it started.
    """

    def hear():
        for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)

    how = {"stderr": subprocess.PIPE, "text": True, "preexec_fn": hear, "start_new_session": True}
    with subprocess.Popen(typed, **how) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)


def _told(process, number, folder):
    """What a command says that is told to stop once there is something half-written."""
    while process.poll() is None and not list(folder.rglob(".*.part")):
        time.sleep(0.001)
    process.send_signal(number)
    return process.communicate(timeout=60)[1]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_command_told_to_stop_leaves_nothing_half_written(tmp_path, robot, number):
    out, typed = tmp_path / "out.mcap", ("estimate", robot / "reach.mcap", "--body", robot / "body.npz")
    out.write_bytes(b"of an earlier run")
    with _begun(_command(*typed, "-o", out)) as process:
        said = _told(process, number, tmp_path)
    assert process.returncode == 128 + number
    how = "interrupted" if number == signal.SIGINT else "stopped"
    assert said.strip() == f"bodylog: {how}; nothing half-written was left"
    assert list(tmp_path.iterdir()) == [out] and out.read_bytes() == b"of an earlier run"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_batch_told_to_stop_ends_its_workers_without_a_trace(tmp_path, robot, number):
    typed = ("batch", robot / "reach.mcap", robot / "explore.mcap", "--body", robot / "body.npz", "--jobs", 2)
    with _begun(_command(*typed, "-o", tmp_path)) as process:
        assert "nothing half-written was left" in _told(process, number, tmp_path)
    assert process.returncode == 128 + number
    assert not list(tmp_path.rglob(".*.part")) and not list(tmp_path.rglob("row.json"))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_reproduction_told_to_stop_does_not_wait_for_what_runs(tmp_path, number):
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")
    typed = ("reproduce", "E2", "--seeds", 2, "--jobs", 2)
    with _begun(_command(*typed, "-o", tmp_path)) as process:
        assert "nothing half-written was left" in _told(process, number, tmp_path)
    assert process.returncode == 128 + number
    assert not list(tmp_path.rglob(".*.part")) and not list(tmp_path.rglob("trials/*.json"))


FULL = {
    "estimate": ("reach.mcap", "--body", "body.npz", "-o", "out.mcap"),
    "extract": ("reach.mcap", "-o", "out.mcap"),
    "ingest": ("reach.mcap", "-o", "out.mcap"),
    "doctor": ("reach.mcap", "--repair", "out.mcap"),
    "fit": ("explore.mcap", "-o", "out.npz"),
    "plot": ("reach.mcap", "-o", "out.png"),
    "colours": ("reach.mcap", "-o", "out.png"),
    "record": ("reach", "--duration", "1", "-o", "out.mcap"),
}


@pytest.mark.parametrize("name", FULL)
def test_where_there_is_no_room_is_said_in_one_line_and_nothing_is_left(tmp_path, robot, name):
    words = [tmp_path / word if word.startswith("out.") else word for word in FULL[name]]
    words = [robot / word if (robot / word).is_file() else word for word in words]

    def little_room():
        resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))

    done = subprocess.run(_command(name, *words), capture_output=True, text=True, preexec_fn=little_room)
    out = next(word for word in words if str(word).startswith(str(tmp_path)))
    *talk, last = done.stderr.splitlines()
    assert last == f"bodylog: {out}: File too large; give another name with -o" and done.returncode == 65
    assert all(line.startswith(("info: ", "warning: ")) for line in talk) and not list(tmp_path.iterdir())


def test_a_reader_that_leaves_is_no_bug(robot):
    typed = _command("compare", robot / "reach.mcap", "--body", robot / "body.npz")
    with subprocess.Popen(typed, stdout=subprocess.PIPE, stderr=subprocess.PIPE, bufsize=0) as process:
        assert process.stdout.readline().startswith(b"method")
        process.stdout.close()
        assert b"Traceback" not in process.stderr.read()
    assert process.returncode == 141


def test_a_pipe_is_no_log(tmp_path, capsys, bodylog):
    os.mkfifo(tmp_path / "log.mcap")
    assert bodylog("info", tmp_path / "log.mcap") == 65
    assert "is a pipe or device" in capsys.readouterr().err

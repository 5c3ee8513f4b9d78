"""Commands that cannot go on, as processes of their own: what they began is gone, what was there stays."""

import os
import random
import resource
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import bodylog_cli
import pytest

from tests.seeds import first_of

COMMAND = (sys.executable, "-m", "bodylog_cli")


def _command(*typed):
    return [*COMMAND, *map(str, typed)]


@contextmanager
def _started(typed):
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


def _shown(process, number, folder):
    """Standard error of a command stopped once something is half-written."""
    while process.poll() is None and not list(folder.rglob(".*.part")):
        time.sleep(0.001)
    process.send_signal(number)
    return process.communicate(timeout=60)[1]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_stopped_command_leaves_no_partial_output(tmp_path, robot, number):
    out, typed = tmp_path / "out.mcap", ("estimate", robot / "reach.mcap", "--body", robot / "body.npz")
    out.write_bytes(b"of an earlier run")
    with _started(_command(*typed, "-o", out)) as process:
        printed = _shown(process, number, tmp_path)
    assert process.returncode == 128 + number
    how = "interrupted" if number == signal.SIGINT else "stopped"
    assert printed.strip() == f"bodylog: {how}; nothing half-written was left"
    assert list(tmp_path.iterdir()) == [out] and out.read_bytes() == b"of an earlier run"


@pytest.mark.parametrize("number", first_of(1, [signal.SIGTERM, signal.SIGINT]))
def test_stopped_batch_ends_its_workers_without_traceback(tmp_path, robot, number):
    typed = ("batch", robot / "reach.mcap", robot / "explore.mcap", "--body", robot / "body.npz", "--jobs", 2)
    with _started(_command(*typed, "-o", tmp_path)) as process:
        assert "nothing half-written was left" in _shown(process, number, tmp_path)
    assert process.returncode == 128 + number
    assert not list(tmp_path.rglob(".*.part")) and not list(tmp_path.rglob("row.json"))


def _workers(process):
    """The processes that another started to work for it."""
    found = subprocess.run(["pgrep", "-P", str(process.pid), "-f", "spawn_main"], capture_output=True, text=True)
    return [int(number) for number in found.stdout.split()]


def _wait_for_workers(process, folder):
    """The two workers of a command, once something in `folder` is half-written."""
    while process.poll() is None and not (list(folder.rglob(".*.part")) and len(_workers(process)) == 2):
        time.sleep(0.005)
    return _workers(process)


def _gone(number):
    try:
        return Path(f"/proc/{number}/stat").read_text().split(") ")[1][0] == "Z"
    except FileNotFoundError:
        return True


@pytest.mark.skipif(sys.platform != "linux", reason="looks at /proc")
@pytest.mark.parametrize("name", ["batch", pytest.param("reproduce", marks=pytest.mark.soak)])
def test_workers_end_with_who_started_them_and_is_killed(tmp_path, robot, name):
    """Also in the middle of a log."""
    batch = ("batch", robot / "explore.mcap", robot / "reach.mcap", "--body", robot / "body.npz")
    typed = {"batch": batch, "reproduce": ("reproduce", "E2", "--seeds", 2)}[name]
    with _started(_command(*typed, "--jobs", 2, "-o", tmp_path / "out")) as process:
        workers, started = _wait_for_workers(process, tmp_path), time.monotonic()
        process.kill()
        process.wait(timeout=60)
        while not all(map(_gone, workers)) and time.monotonic() - started < 10:
            time.sleep(0.01)
        assert len(workers) == 2 and all(map(_gone, workers)) and time.monotonic() - started < 2
    assert not list(tmp_path.rglob(".*.part")) and not list(tmp_path.rglob("row.json"))


IN_C = """
import sqlite3, sys
import bodylog_cli
from bodylog import pipeline
def endless(*_):
    print("on", flush=True)
    query = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT count(*) FROM n"
    sqlite3.connect(":memory:").execute(query).fetchall()
pipeline.observe = endless
bodylog_cli.main()
"""


@pytest.mark.parametrize("number", first_of(1, [signal.SIGINT, signal.SIGTERM]))
def test_command_inside_c_code_stops_in_time(tmp_path, robot, number):
    words = ("estimate", robot / "reach.mcap", "--body", robot / "body.npz", "-o", tmp_path / "out.mcap")
    with _started([sys.executable, "-c", IN_C, *map(str, words)]) as process:
        while not list(tmp_path.glob(".*.part")):
            time.sleep(0.005)
        time.sleep(0.2)
        started = time.monotonic()
        process.send_signal(number)
        printed = process.communicate(timeout=60)[1]
        seconds = time.monotonic() - started
    how = "interrupted" if number == signal.SIGINT else "stopped"
    assert (process.returncode, printed) == (128 + number, f"bodylog: {how}; nothing half-written was left\n")
    assert seconds < 2 and not list(tmp_path.iterdir())


def test_interrupt_before_signals_are_listened_to_is_one_line(monkeypatch, capfd):
    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setattr(bodylog_cli, "_raise_on_signals", interrupted)
    with pytest.raises(SystemExit) as ended:
        bodylog_cli.main(["info"])
    assert ended.value.code == 130
    assert capfd.readouterr().err == "bodylog: interrupted; nothing half-written was left\n"


COMMANDS = {
    "record": ("reach", "--duration", 4, "--size", "160x120", "-o", "OUT/x.mcap"),
    "ingest": ("reach.mcap", "-o", "OUT/x.mcap", "--csv", "OUT/tables"),
    "info": ("explore.mcap", "reach.mcap"),
    "doctor": ("explore.mcap", "--repair", "OUT/x.mcap"),
    "colours": ("reach.mcap", "-o", "OUT/x.png"),
    "extract": ("explore.mcap", "-o", "OUT/x.mcap", "--csv", "OUT/tables"),
    "fit": ("explore.mcap", "-o", "OUT/x.npz"),
    "estimate": ("reach.mcap", "--body", "body.npz", "-o", "OUT/x.mcap"),
    "compare": ("reach.mcap", "--body", "body.npz"),
    "plot": ("reach.mcap", "-o", "OUT/x.png"),
    "view": ("reach.mcap", "-o", "OUT/x.rrd"),
    "batch": ("reach.mcap", "explore.mcap", "--body", "body.npz", "-o", "OUT/b", "--jobs", 2),
    "reproduce": ("E2", "--seeds", 2, "--jobs", 2, "-o", "OUT/r"),
}


@pytest.mark.soak
@pytest.mark.parametrize("name", COMMANDS)
def test_command_stops_in_time_at_any_moment(tmp_path, robot, name):
    """After its start: while Python itself starts, a signal ends Python."""
    rng = random.Random(name)
    for k in range(24):
        number = rng.choice([signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
        out, temporary = tmp_path / f"out{k}", tmp_path / f"tmp{k}"
        out.mkdir()
        temporary.mkdir()
        words = [str(word).replace("OUT", str(out)) for word in COMMANDS[name]]
        words = [str(robot / word) if (robot / word).is_file() else word for word in words]
        with _started(["env", f"TMPDIR={temporary}", *_command(name, *words)]) as process:
            time.sleep(rng.uniform(0.1, rng.choice([0.8, 5.0])))
            started = time.monotonic()
            process.send_signal(number)
            printed = process.communicate(timeout=60)[1]
            seconds = time.monotonic() - started
        if process.returncode in (0, -number) or printed.rstrip().endswith("KeyboardInterrupt"):
            continue  # it ended before, or had not started
        ends = [line for line in printed.splitlines() if "nothing half-written was left" in line]
        assert (process.returncode, len(ends)) == (128 + number, 1) and "Traceback" not in printed, printed
        assert seconds < 2 and not [*out.rglob(".*.part"), *temporary.glob("bodylog-*"), *temporary.rglob("*.part")]


@pytest.mark.parametrize("number", [signal.SIGINT])
@pytest.mark.soak
def test_stopped_reproduction_does_not_wait_for_its_runs(tmp_path, number):
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")
    typed = ("reproduce", "E2", "--seeds", 2, "--jobs", 2)
    with _started(_command(*typed, "-o", tmp_path)) as process:
        assert "nothing half-written was left" in _shown(process, number, tmp_path)
    assert process.returncode == 128 + number
    assert not list(tmp_path.rglob(".*.part")) and not list(tmp_path.rglob("trials/*.json"))


def test_workers_that_are_killed_leave_nothing(tmp_path):
    """For lack of memory, say: they cannot unwind."""
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    made = _command("reproduce", "E2", "--seeds", 2, "--jobs", 2, "-o", tmp_path / "out")
    typed = ["env", f"TMPDIR={temporary}", *made]
    with _started(typed) as process:
        workers = _wait_for_workers(process, temporary)
        assert len(workers) == 2 and list(temporary.glob("bodylog-*/.*.part"))
        for worker in workers:
            os.kill(worker, signal.SIGKILL)
        process.communicate(timeout=60)
    assert process.returncode == 3 and not list(tmp_path.rglob("*.part")) and not list(temporary.glob("bodylog-*"))


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


@pytest.mark.parametrize("name", first_of(4, FULL))
def test_full_disk_prints_one_line_and_leaves_nothing(tmp_path, robot, name):
    words = [tmp_path / word if word.startswith("out.") else word for word in FULL[name]]
    words = [robot / word if (robot / word).is_file() else word for word in words]

    def little_room():
        resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))

    done = subprocess.run(_command(name, *words), capture_output=True, text=True, preexec_fn=little_room)
    out = next(word for word in words if str(word).startswith(str(tmp_path)))
    *talk, last = done.stderr.splitlines()
    assert last == f"bodylog: {out}: File too large; give another name with -o" and done.returncode == 74
    assert all(line.startswith(("info: ", "warning: ")) for line in talk) and not list(tmp_path.iterdir())


def test_closed_standard_output_is_not_a_bug(robot):
    typed = _command("compare", robot / "reach.mcap", "--body", robot / "body.npz")
    with subprocess.Popen(typed, stdout=subprocess.PIPE, stderr=subprocess.PIPE, bufsize=0) as process:
        assert process.stdout.readline().startswith(b"method")
        process.stdout.close()
        assert b"Traceback" not in process.stderr.read()
    assert process.returncode == 141


def test_pipe_is_not_a_log(tmp_path, capsys, run_cli):
    os.mkfifo(tmp_path / "log.mcap")
    assert run_cli("info", tmp_path / "log.mcap") == 65
    assert "is a pipe or device" in capsys.readouterr().err

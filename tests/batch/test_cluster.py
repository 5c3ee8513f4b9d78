"""The same work by a Dask scheduler: the same bytes, also when a worker is killed."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

pytest.importorskip("distributed", reason="the dask extra is not installed")


@pytest.fixture(scope="module")
def logs(tmp_path_factory, robot):
    folder = tmp_path_factory.mktemp("logs")
    for name in ("a", "b", "c"):
        (folder / f"{name}.mcap").write_bytes((robot / "reach.mcap").read_bytes())
    return folder


def _start(logs, robot, out, *scheduler):
    typed = ("batch", logs, "-o", out, "--body", robot / "body.npz", *scheduler)
    command = [sys.executable, "-m", "bodylog_cli", *map(str, typed)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def _results(out):
    return (out / "results.jsonl").read_bytes()


def test_scheduler_gives_the_same_bytes_as_the_pool(tmp_path, logs, robot, run_cli):
    assert run_cli("batch", logs, "-o", tmp_path / "pool", "--body", robot / "body.npz") == 0
    process = _start(logs, robot, tmp_path / "dask", "--scheduler", "local", "--jobs", "2")
    _, error = process.communicate(timeout=120)
    assert process.returncode == 0, error
    assert _results(tmp_path / "dask") == _results(tmp_path / "pool")


@pytest.mark.soak
def test_killed_workers_log_is_finished_by_another(tmp_path, logs, robot, run_cli):
    address = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--no-dashboard", "--port", "0"]
    scheduler = subprocess.Popen([*dask, "--scheduler-file", address], stderr=subprocess.DEVNULL)
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--no-nanny", "--no-dashboard", "--nthreads", "1"]
    workers = []
    try:
        tcp = _tcp(address)
        workers = [subprocess.Popen([*worker, tcp], stderr=subprocess.DEVNULL) for _ in range(2)]
        process = _start(logs, robot, tmp_path / "out", "--scheduler", tcp)
        while not (tmp_path / "out" / "a.mcap" / ".bodylog-result").exists():
            time.sleep(0.01)
        os.kill(workers[0].pid, signal.SIGKILL)
        _, error = process.communicate(timeout=120)
        assert process.returncode == 0, error
    finally:
        for started in [*workers, scheduler]:
            started.kill()
            started.wait()
    assert run_cli("batch", logs, "-o", tmp_path / "pool", "--body", robot / "body.npz") == 0
    assert _results(tmp_path / "out") == _results(tmp_path / "pool")


def _tcp(address):
    for _ in range(600):
        if address.exists() and address.read_text().strip():
            return json.loads(address.read_text())["address"]
        time.sleep(0.05)
    raise AssertionError("the scheduler did not start")


def test_absent_scheduler_is_an_error(tmp_path, logs, robot):
    process = _start(logs, robot, tmp_path / "out", "--scheduler", "tcp://127.0.0.1:1")
    _, error = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "tcp://HOST:PORT" in error.strip().splitlines()[-1]

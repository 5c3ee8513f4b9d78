"""A command that is told to stop, as a process of its own: what it began is gone, what was there stays."""

import signal
import subprocess
import sys
import time

import pytest


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_command_told_to_stop_leaves_nothing_half_written(tmp_path, robot, number):
    out, typed = tmp_path / "out.mcap", ("estimate", robot / "reach.mcap", "--body", robot / "body.npz")
    out.write_bytes(b"of an earlier run")
    command = [sys.executable, "-m", "bodylog_cli", *map(str, typed), "-o", str(out)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        while process.poll() is None and not list(tmp_path.glob(".*.part")):
            time.sleep(0.001)
        process.send_signal(number)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert said == "bodylog: stopped; nothing half-written was left\n"
    assert list(tmp_path.iterdir()) == [out] and out.read_bytes() == b"of an earlier run"

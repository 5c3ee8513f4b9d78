"""Signals that end a process, tested in separate processes."""

import os
import signal
import subprocess
import sys
import time

import pytest

from tests.seeds import first_of

BEGIN = """import os, signal, sys, time
from bodylog.runtime import signals
signals.raise_on_signal(signal.SIGTERM, signal.SIGINT)
"""
ON = "print('on', flush=True)"
WAIT = "for _ in range(2000): time.sleep(0.005)\n"

SWALLOWED = f"""
try:
    {ON}
    time.sleep(10)
except BaseException:
    pass
"""
CLEANING = f"""
try:
    {ON}
    time.sleep(10)
finally:
    for _ in range(50): time.sleep(0.005)
    print('cleaned', flush=True)
"""
IN_C = f"""
import sqlite3
from pathlib import Path
from bodylog.io.atomic_files import replace_atomically
from bodylog.io.temporary import create_scratch_folder
place = Path(sys.argv[1])
with create_scratch_folder(place) as folder, replace_atomically(place / "out") as beside:
    (folder / "file").touch()
    beside.write_bytes(b"half")
    {ON}
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT count(*) FROM n"
    sqlite3.connect(":memory:").execute(endless).fetchall()
"""
PRINTED = f"""
import ctypes
from pathlib import Path
from bodylog.io.atomic_files import replace_atomically
from bodylog.io.temporary import create_scratch_folder
place = Path(sys.argv[1])
with create_scratch_folder(place) as folder, replace_atomically(place / "out") as beside:
    (folder / "file").touch()
    beside.write_bytes(b"half")
    {ON}
    ctypes.pythonapi.PyRun_SimpleString(b"import time\\nfor _ in range(2000): time.sleep(0.005)")
"""
DESTRUCTOR = f"""
class Slow:
    def __del__(self):
        {ON}
        time.sleep(10)
slow = Slow()
del slow
{WAIT}"""


def _signalled(script, *numbers, typed=()):
    """Output after these signals, the last being why it ends; exit code, seconds, and errors."""
    command = [sys.executable, "-c", BEGIN + script, *typed]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "on\n"
        time.sleep(0.2)  # it may not have reached the signalled code yet
        start = time.monotonic()
        for number in numbers:
            process.send_signal(number)
        lines, errors = process.communicate(timeout=30)
    return lines.split(), process.returncode, time.monotonic() - start, errors


def test_raise_on_signal_exits_with_128_plus_its_number():
    assert _signalled(f"{ON}\n{WAIT}", signal.SIGTERM)[:2] == ([], 128 + signal.SIGTERM)


NOT_UNWOUND = {"swallowed": SWALLOWED + WAIT, "destructor": DESTRUCTOR, "in C": IN_C, "printed by C": PRINTED}


@pytest.mark.parametrize("script", NOT_UNWOUND.values(), ids=NOT_UNWOUND)
@pytest.mark.parametrize("number", first_of(1, [signal.SIGTERM, signal.SIGINT]))
def test_raise_on_signal_ends_code_that_does_not_unwind(tmp_path, script, number):
    lines, code, seconds, errors = _signalled(script, number, typed=[tmp_path])
    how = "interrupted" if number == signal.SIGINT else "stopped"
    assert (lines, code, errors) == ([], 128 + number, f"bodylog: {how}; nothing half-written was left\n")
    assert seconds < 2 and not os.listdir(tmp_path)


@pytest.mark.parametrize("times", [1, 2])
def test_raise_on_signal_lets_cleaning_finish(times):
    assert _signalled(CLEANING, *[signal.SIGTERM] * times)[:2] == (["cleaned"], 128 + signal.SIGTERM)


def test_raise_on_signal_ends_with_a_full_pipe(tmp_path):
    """Its output pipe is full, so that nothing can be written."""
    command = [sys.executable, "-c", BEGIN + "os.set_blocking(2, False)\ntry:\n    while True: os.write(2, b'x' * 4096)"
               f"\nexcept BlockingIOError: os.set_blocking(2, True)\n{ON}\n" + SWALLOWED + WAIT]  # fmt: skip
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"on\n"
        start = time.monotonic()
        process.terminate()
        assert process.wait(timeout=30) == 128 + signal.SIGTERM and time.monotonic() - start < 2

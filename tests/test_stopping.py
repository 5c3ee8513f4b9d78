"""A signal that ends a process, as processes of their own."""

import signal
import subprocess
import sys

import pytest

BEGIN = """import signal, sys, time
from bodylog import stopping
stopping.heed(signal.SIGTERM)
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
SLOW_CLEANING = f"""
from contextlib import contextmanager
@contextmanager
def cleaned():
    try:
        yield
    finally:
        for _ in range(160): time.sleep(0.005)
        print('cleaned', flush=True)
try:
    with cleaned():
        {ON}
        time.sleep(10)
finally:
    for _ in range(160): time.sleep(0.005)
    print('all', flush=True)
    stopping.calm()
"""


def _said(script, *numbers):
    """What it prints after it was sent these signals, the last being why it ends, and its code."""
    with subprocess.Popen([sys.executable, "-c", BEGIN + script], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "on\n"
        for number in numbers:
            process.send_signal(number)
        said = process.communicate(timeout=30)[0]
    return said.split(), process.returncode


def test_it_ends_the_process_with_128_and_its_number():
    assert _said(f"{ON}\n{WAIT}", signal.SIGTERM) == ([], 128 + signal.SIGTERM)


def test_swallowed_once_it_is_heard_again():
    assert _said(SWALLOWED + WAIT, signal.SIGTERM) == ([], 128 + signal.SIGTERM)


@pytest.mark.parametrize("times", [1, 2])
def test_cleaning_that_takes_longer_than_that_is_left_alone(times):
    assert _said(SLOW_CLEANING, *[signal.SIGTERM] * times) == (["cleaned", "all"], 128 + signal.SIGTERM)

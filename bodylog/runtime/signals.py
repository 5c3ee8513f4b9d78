"""End the process on a signal: unwind, or exit anyway
if that takes too long, as in a library's C code.
"""

import _thread
import atexit
import os
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import NoReturn

GRACE = 1.2
"""Seconds for unwinding, so that a command ends within 2 s."""
GRACE_OF_WORKERS = 0.6
"""Seconds for a worker, so that its parent ends in time as well."""

LAST = 0.4
"""Further seconds for removing half-written files."""


class Stopped(SystemExit):
    """A signal asked the process to end; its code is 128 + the signal's number."""


at_end: list[Callable[[], None]] = []
"""Functions to run before a process ends without unwinding; none may import anything."""
_heeded: set[int] = set()
_received: list[int] = []
_speaking = _thread.allocate_lock()
_cleaned: list[bool] = []


def raise_on_signal(*numbers: int, grace: float = GRACE, quiet: bool = False) -> None:
    """Raise Stopped on these signals, and end the process `grace` s later if it still runs.

    A thread ends it, so that the main thread need not
    execute Python. A `quiet` process prints nothing.
    """
    if not _heeded:
        read, write = os.pipe()
        os.set_blocking(write, False)
        signal.set_wakeup_fd(write, warn_on_full_buffer=False)
        _thread.start_new_thread(_watch_signals, (read, grace, quiet))
        sys.unraisablehook = _ignore_unraisable
        atexit.register(_clean_up_at_exit, quiet)
    for number in numbers:
        _heeded.add(number)
        signal.signal(number, _request_stop)


def received_signal() -> int:
    """The signal that asked this process to end; 0 for none."""
    return _received[0] if _received else 0


def clean_up(quiet: bool = False) -> None:
    """Remove half-written files, and report it once."""
    for remove in at_end:
        remove()
    if not quiet and _speaking.acquire(blocking=False):
        how = "interrupted" if received_signal() == signal.SIGINT else "stopped"
        with suppress(OSError):
            os.write(2, f"bodylog: {how}; nothing half-written was left\n".encode())
    _cleaned.append(True)


def _clean_up_at_exit(quiet: bool) -> None:
    """Clean up if the interpreter ends without unwinding.

    C code that prints an exception (PyErr_Print, called by NumPy's
    import_array while an extension is imported) ends the process if
    that exception is a SystemExit, as Stopped is: no `finally` runs.
    """
    if received_signal() and not _cleaned:
        clean_up(quiet)


def _request_stop(number: int, _: object) -> NoReturn:
    for each in _heeded:
        signal.signal(each, signal.SIG_IGN)
    _received.append(number)
    raise Stopped(128 + number)


def _watch_signals(read: int, grace: float, quiet: bool) -> NoReturn:
    """Wait for a signal's number in the pipe, whatever the main thread does."""
    number = 0
    while number not in _heeded:
        number = os.read(read, 1)[0]
    time.sleep(grace)
    end_process(number, quiet)


def end_process(number: int, quiet: bool) -> NoReturn:
    """Remove half-written files and end the process at once with 128 + `number`."""
    _received.append(number)
    _thread.start_new_thread(_exit_after, (128 + number, LAST))
    clean_up(quiet)
    _exit_after(128 + number, 0.0)


def _exit_after(code: int, seconds: float) -> NoReturn:
    """End after some seconds: a disk may be slow, and a terminal stopped."""
    time.sleep(seconds)
    os._exit(code)


def _ignore_unraisable(problem: "sys.UnraisableHookArgs") -> None:
    """Ignore an interrupted destructor, which cannot raise."""
    if not isinstance(problem.exc_value, Stopped):
        sys.__unraisablehook__(problem)

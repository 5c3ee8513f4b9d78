"""Told to end by a signal: unwind, so that nothing half-written stays, also where a library swallows that once."""

import signal
import sys
from functools import partial
from typing import Any

AGAIN = 0.25
"""Seconds after which it is looked whether the process is on its way out: a library being loaded may have gone on."""


class Stopped(SystemExit):
    """The process was told to end; its code is 128 + the signal's number."""


def heed(number: int) -> None:
    """Raise Stopped where that signal comes, and once more where it was swallowed; told again, go on with that."""
    signal.signal(number, _stop)


def calm() -> None:
    """The way out has been walked: look no more."""
    signal.setitimer(signal.ITIMER_REAL, 0.0)


def _stop(number: int, _: Any) -> None:
    signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, partial(_insist, number))
    signal.setitimer(signal.ITIMER_REAL, AGAIN, AGAIN)
    raise Stopped(128 + number)


def _insist(number: int, *_: Any) -> None:
    if not _unwinding():
        raise Stopped(128 + number)


def _unwinding() -> bool:
    """Whether what runs now was called on the way out, by a `finally` or at the end of a `with`."""
    error = sys.exception()
    while error is not None and not isinstance(error, Stopped):
        error = error.__context__
    return error is not None

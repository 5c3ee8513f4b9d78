"""Worker processes: they leave interrupts to who started them, and end as an interrupt does when told to."""

import multiprocessing
import signal
from collections.abc import Iterator
from contextlib import contextmanager

from . import memory


def ready() -> None:
    """Make this process a worker."""
    memory.keep()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _end)


def _end(*_: object) -> None:
    """Unwind, so that nothing half-written stays; again a second later, as a library being loaded may swallow that."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, _end)
    signal.setitimer(signal.ITIMER_REAL, 1.0)
    raise SystemExit(128 + signal.SIGTERM)


@contextmanager
def ended() -> Iterator[None]:
    """Tell the processes started in a `with` to end where it fails, instead of waiting for what they do."""
    before = multiprocessing.active_children()
    try:
        yield
    except BaseException:
        for child in multiprocessing.active_children():
            if child not in before:
                child.terminate()
        raise

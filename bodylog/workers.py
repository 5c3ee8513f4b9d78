"""Worker processes: they leave interrupts to who started them, and end as an interrupt does when told to."""

import multiprocessing
import signal
from collections.abc import Iterator
from contextlib import contextmanager

from . import memory
from .stopping import heed


def ready() -> None:
    """Make this process a worker."""
    memory.keep()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    heed(signal.SIGTERM)


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

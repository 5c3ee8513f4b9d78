"""Worker processes: they leave interrupts to who started them, end as those do when told to, and never outlive them."""

import multiprocessing
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from threading import Thread
from time import monotonic

from . import malloc
from .signals import GRACE_OF_WORKERS, raise_on_signal

PATIENCE = GRACE_OF_WORKERS + 0.3
"""Seconds after which a worker that was told to end is killed."""


def ready() -> None:
    """Make this process a worker."""
    malloc.tune_malloc()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise_on_signal(signal.SIGTERM, grace=GRACE_OF_WORKERS, quiet=True)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Told to end where the process is gone that started this one, killed say: nobody would take what it makes."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold interrupts back while processes are started, which inherit that: they would not end in one line."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def stop(processes: list[BaseProcess]) -> None:
    """Tell processes to end, and kill those that do not."""
    for process in processes:
        process.terminate()
    until = monotonic() + PATIENCE
    for process in processes:
        process.join(max(0.0, until - monotonic()))
        if process.is_alive():
            process.kill()
            process.join()


@contextmanager
def ended() -> Iterator[None]:
    """Tell the processes started in a `with` to end where it fails, instead of waiting for what they do."""
    before = multiprocessing.active_children()
    try:
        yield
    except BaseException:
        stop([child for child in multiprocessing.active_children() if child not in before])
        raise

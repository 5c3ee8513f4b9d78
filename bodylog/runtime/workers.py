"""Worker processes: interrupts go to the parent, they end on its signal, and never outlive it."""

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
"""Seconds after which a worker that ignores its signal is killed."""


def become_worker() -> None:
    """Make this process a worker."""
    malloc.tune_malloc()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise_on_signal(signal.SIGTERM, grace=GRACE_OF_WORKERS, quiet=True)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Ask the kernel to end this process when its parent is gone, for example killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


@contextmanager
def block_interrupts() -> Iterator[None]:
    """Block interrupts while processes are started, which
    inherit the block: they would print a traceback.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def stop_processes(processes: list[BaseProcess]) -> None:
    """Terminate processes, and kill those that do not end."""
    for process in processes:
        process.terminate()
    until = monotonic() + PATIENCE
    for process in processes:
        process.join(max(0.0, until - monotonic()))
        if process.is_alive():
            process.kill()
            process.join()


@contextmanager
def end_children_on_failure() -> Iterator[None]:
    """Terminate the processes started in a `with` block if it fails, without waiting for them."""
    before = multiprocessing.active_children()
    try:
        yield
    except BaseException:
        stop_processes(
            [child for child in multiprocessing.active_children() if child not in before]
        )
        raise

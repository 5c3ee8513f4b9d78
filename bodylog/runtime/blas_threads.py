"""One thread for libraries, as numpy, scipy and OpenCV
each start threads that spin when idle; thread priority.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module


@contextmanager
def one_thread(*needed: str) -> Iterator[None]:
    """One BLAS thread in the block, then as many as before:
    faster for small matrices, and reproducible bytes.

    `needed` modules are imported first: BLAS can be limited only once it is loaded.
    """
    for name in needed:
        import_module(name)
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, "blas"):
        yield


@contextmanager
def one_opencv() -> Iterator[None]:
    """OpenCV on the calling threads in the block, then
    on its own threads again: faster for small images.
    """
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


@contextmanager
def without_real_time() -> Iterator[None]:
    """Threads that became real-time in the block are scheduled as the calling one before it.

    SVT-AV1 makes the thread that opens an encoder, and its own, real-time where it may, as root:
    at priority 99 all other processes stand still while they run.
    """
    if sys.platform != "linux":
        yield
        return
    policy = os.sched_getscheduler(0)
    priority = os.sched_getparam(0)
    before = _real_time_threads()
    try:
        yield
    finally:
        for thread in _real_time_threads() - before:
            with suppress(ProcessLookupError):  # it ended meanwhile
                os.sched_setscheduler(thread, policy, priority)


def _real_time_threads() -> set[int]:
    """The numbers of this process's real-time threads."""
    found = set[int]()
    for name in os.listdir("/proc/self/task"):
        with suppress(ProcessLookupError):
            if os.sched_getscheduler(int(name)) in (os.SCHED_FIFO, os.SCHED_RR):
                found.add(int(name))
    return found


def lower_priority() -> None:
    """Lower this thread's priority for its lifetime: if cores are short, other threads go first."""
    if sys.platform == "linux":  # elsewhere it would affect the whole process
        os.nice(5)

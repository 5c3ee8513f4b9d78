"""One thread for libraries, as numpy, scipy and OpenCV
each start threads that spin when idle; thread priority.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
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


def lower_priority() -> None:
    """Lower this thread's priority for its lifetime: if cores are short, other threads go first."""
    if sys.platform == "linux":  # elsewhere it would affect the whole process
        os.nice(5)

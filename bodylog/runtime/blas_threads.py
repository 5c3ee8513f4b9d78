"""Libraries on one thread, as numpy, scipy and OpenCV each bring threads that spin when idle; and who comes first."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module


@contextmanager
def one_thread(*needed: str) -> Iterator[None]:
    """One BLAS thread meanwhile, as many as before afterwards: small matrices are faster so, and the bytes the same.

    `needed` modules are imported first: their BLAS can be told only once it is loaded.
    """
    for name in needed:
        import_module(name)
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, "blas"):
        yield


@contextmanager
def one_opencv() -> Iterator[None]:
    """OpenCV on the threads that call it meanwhile, on its own as well afterwards: small pictures are faster so."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def lower_priority() -> None:
    """Let this thread, from now on, come after others: where cores are short, those go on whose work it cannot take."""
    if sys.platform == "linux":  # elsewhere it would be the whole process
        os.nice(5)

"""Libraries on one thread: numpy, scipy and OpenCV each bring threads, which spin in each other's way when idle."""

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

"""Linear algebra on one thread: numpy and scipy each bring a BLAS, whose idle threads spin in each other's way."""

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

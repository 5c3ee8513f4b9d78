"""Linear algebra on one thread: numpy and scipy each bring a BLAS, whose idle threads spin in each other's way."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_thread() -> Iterator[None]:
    """One BLAS thread meanwhile, as many as before afterwards: small matrices are faster so, and the bytes the same."""
    import scipy.linalg  # noqa: F401  its BLAS can be told only once it is loaded
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, "blas"):
        yield

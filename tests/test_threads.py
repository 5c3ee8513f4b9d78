from importlib import import_module

import pytest
import scipy.linalg  # noqa: F401  its BLAS can be told only once it is loaded
from threadpoolctl import threadpool_info, threadpool_limits

from bodylog.body import learn
from bodylog.errors import EvidenceError
from bodylog.estimation import METHODS, estimate
from bodylog.settings import Estimation, Settings
from bodylog.threads import one_thread


def _threads() -> list[int]:
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


@pytest.fixture
def two():
    """Two threads for each BLAS, whatever the machine or the environment asked for."""
    with threadpool_limits(2, "blas"):
        if set(_threads()) != {2}:
            pytest.skip("this BLAS cannot be given two threads")
        yield


def test_linear_algebra_has_one_thread_meanwhile_and_as_many_as_before_afterwards(two) -> None:
    with one_thread():
        assert set(_threads()) == {1}
    assert set(_threads()) == {2}


def _running(run, monkeypatch) -> set[int]:
    """How many threads there are while a body is learned or a log estimated: both stop at once and ask."""
    seen: list[int] = []

    def stop(*_):
        seen.extend(_threads())
        raise EvidenceError("enough")

    monkeypatch.setattr(import_module("bodylog.body.learn"), "joints", stop)
    monkeypatch.setitem(METHODS, "laplace", stop)
    with pytest.raises(EvidenceError):
        run()
    return set(seen)


def test_bodies_are_learned_and_logs_estimated_on_one_thread(two, monkeypatch) -> None:
    assert _running(lambda: learn([], Settings(), {}), monkeypatch) == {1}
    assert _running(lambda: estimate(None, None, Estimation()), monkeypatch) == {1}
    assert set(_threads()) == {2}

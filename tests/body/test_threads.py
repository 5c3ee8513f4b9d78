from importlib import import_module

import pytest
import scipy.linalg  # noqa: F401  its BLAS can be told only once it is loaded
from threadpoolctl import threadpool_info, threadpool_limits

from bodylog.body import learn
from bodylog.body.threads import one_thread
from bodylog.errors import EvidenceError
from bodylog.settings import Settings


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


def test_a_body_is_learned_on_one_thread(two, explored, monkeypatch) -> None:
    seen: list[int] = []

    def stop(*_):
        seen.extend(_threads())
        raise EvidenceError("enough")

    monkeypatch.setattr(import_module("bodylog.body.learn"), "joints", stop)
    with pytest.raises(EvidenceError):
        learn([explored(0, 0.003, 10.0).features], Settings(), {})
    assert set(seen) == {1} and set(_threads()) == {2}

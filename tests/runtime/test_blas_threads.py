import os
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import scipy.linalg  # noqa: F401  its BLAS can be limited only once it is loaded
from threadpoolctl import threadpool_info, threadpool_limits

from bodylog.body import learn_body
from bodylog.errors import EvidenceError
from bodylog.estimation import METHODS, estimate_from_features
from bodylog.runtime.blas_threads import lower_priority, one_thread, without_real_time
from bodylog.settings import EstimationSettings, Settings
from bodylog.types import Features, LazyImage, Series
from tests.perception.scenes import track_colours


def _threads() -> list[int]:
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


@pytest.fixture
def two():
    """Two threads for each BLAS, whatever the machine or environment requests."""
    with threadpool_limits(2, "blas"):
        if set(_threads()) != {2}:
            pytest.skip("this BLAS cannot be given two threads")
        yield


def test_one_thread_limits_blas_and_restores_it(two) -> None:
    with one_thread():
        assert set(_threads()) == {1}
    assert set(_threads()) == {2}


def test_one_opencv_limits_threads_and_restores_them() -> None:
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(3)
        seen: list[int] = []

        def look(_k: int) -> np.ndarray:
            seen.append(cv2.getNumThreads())
            if len(seen) == 3:
                raise RuntimeError("enough")
            return np.zeros((48, 64, 3), np.uint8)

        with pytest.raises(RuntimeError, match="enough"):
            track_colours(lambda: (LazyImage(0.0, 0, look) for _ in range(9)), {"effector": "green"})
        assert set(seen) == {1}
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(before)


def _running(run, monkeypatch) -> set[int]:
    """How many threads exist while a body is learned or a log estimated: both stop at once and count."""
    seen: list[int] = []

    def stop(*_):
        seen.extend(_threads())
        raise EvidenceError("enough")

    monkeypatch.setattr(import_module("bodylog.body.learning"), "smooth_all_joints", stop)
    monkeypatch.setitem(METHODS, "filter", METHODS["filter"]._replace(estimate=stop))
    with pytest.raises(EvidenceError):
        run()
    return set(seen)


def test_fit_and_estimate_use_one_thread(two, monkeypatch) -> None:
    track = Series(np.zeros(0), np.zeros((0, 2)), ("u", "v"), "px", np.zeros(0, np.int64))
    seen = Features(None, {"effector": track}, None, (), (), {})
    assert _running(lambda: learn_body([seen], Settings(), {}), monkeypatch) == {1}
    nothing, nobody = Features(None, {}, None, (), (), {}), SimpleNamespace(joints=(), senses={}, provenance={}, surface=None)
    assert _running(lambda: estimate_from_features(nothing, nobody, EstimationSettings()), monkeypatch) == {1}
    assert set(_threads()) == {2}


@pytest.mark.skipif(sys.platform != "linux", reason="threads have no priorities of their own")
def test_lower_priority_yields_to_other_threads() -> None:
    def mine() -> int:
        return os.getpriority(os.PRIO_PROCESS, 0)

    before = mine()
    with ThreadPoolExecutor(1, initializer=lower_priority) as pool:
        assert pool.submit(mine).result() == min(before + 5, 19)
    assert mine() == before


@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux's scheduling")
def test_threads_that_became_real_time_are_as_before():
    with without_real_time():
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        except PermissionError:
            pytest.skip("may not be real-time here; root may")
    assert os.sched_getscheduler(0) == os.SCHED_OTHER and os.sched_getparam(0).sched_priority == 0

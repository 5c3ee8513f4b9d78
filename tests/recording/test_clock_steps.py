"""Clocks that step while a log is recorded, on times alone: steps are found, and nothing else is
taken for one.
"""

import numpy as np
import pytest

from bodylog.recording.clock_steps import Mended, Times, mend_clocks

T0, MS = 1_700_000_000_000_000_000, 1_000_000


def _stream(rng, period_ms, seconds=20.0, delay_ms=3.0, scatter_ms=2.0):
    """True stamps and log times (n,) ns of a stream with transport delays."""
    stamp = T0 + np.rint(np.arange(0.0, 1e3 * seconds, period_ms) * MS).astype(np.int64)
    late = np.rint((delay_ms + rng.exponential(scatter_ms, len(stamp))) * MS).astype(np.int64)
    return stamp, np.maximum.accumulate(stamp + late)


def _mended(log_ns, stamp_ns) -> Mended:
    return mend_clocks({"one": Times(log_ns, stamp_ns)})["one"]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("by_ms", [200, 700, 5000])
@pytest.mark.parametrize("period_ms", [2.0, 20.0, 83.3])
def test_a_stamp_clock_that_steps_is_mended_by_log_time(seed, by_ms, period_ms):
    rng = np.random.default_rng(seed)
    stamp, log = _stream(rng, period_ms)
    row = int(rng.integers(len(stamp) // 10, len(stamp) * 9 // 10))
    found = _mended(log, stamp - by_ms * MS * (np.arange(len(stamp)) >= row))
    (step,) = found.steps
    assert (step.clock, step.row) == ("header", row)
    assert abs(found.stamp_ns - stamp).max() < 2 * MS and (np.diff(found.stamp_ns) > 0).all()


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("by_ms", [25, 50, 90])
def test_a_small_step_of_a_fast_stream_is_mended(seed, by_ms):
    """Stamps fall where the step is longer than the period; in slower streams they keep their
    order.
    """
    rng = np.random.default_rng(seed)
    stamp, log = _stream(rng, 10.0)
    row = int(rng.integers(len(stamp) // 10, len(stamp) * 9 // 10))
    found = _mended(log, stamp - by_ms * MS * (np.arange(len(stamp)) >= row))
    (step,) = found.steps
    assert (step.clock, step.row) == ("header", row)
    assert abs(found.stamp_ns - stamp).max() < 2 * MS and (np.diff(found.stamp_ns) > 0).all()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("by_ms", [50, 400, 5000])
@pytest.mark.parametrize("period_ms", [2.0, 20.0, 83.3])
def test_a_stamp_clock_that_leaps_into_the_future_is_mended(seed, by_ms, period_ms):
    rng = np.random.default_rng(seed)
    stamp, log = _stream(rng, period_ms)
    row = int(rng.integers(len(stamp) // 10, len(stamp) * 9 // 10))
    found = _mended(log, stamp + by_ms * MS * (np.arange(len(stamp)) >= row))
    (step,) = found.steps
    assert (step.clock, step.row, step.by_ns < 0) == ("header", row, True)
    assert abs(found.stamp_ns - stamp).max() < 2 * MS


def test_messages_of_uneven_delay_are_no_steps():
    """Bursts as of a loaded network: a tenth of the messages come up to 60 ms late, with those
    behind them.
    """
    for seed in range(20):
        rng = np.random.default_rng(seed)
        stamp, log = _stream(rng, 10.0)
        held = np.where(rng.random(len(stamp)) < 0.1, rng.integers(0, 60 * MS, len(stamp)), 0)
        log = np.maximum.accumulate(log + held)
        assert not _mended(log, stamp).steps
        row = int(rng.integers(300, 1700))
        (step,) = _mended(log, stamp - 500 * MS * (np.arange(len(stamp)) >= row)).steps
        assert step.row == row


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("by_ms", [200, 700, 5000])
def test_a_recorders_clock_that_steps_is_mended_in_every_stream(seed, by_ms):
    rng = np.random.default_rng(seed)
    at = T0 + int(rng.uniform(2e9, 18e9))
    true = {f"{period} ms": _stream(rng, period) for period in (10.0, 83.3, 400.0)}
    behind = {name: by_ms * MS * (log > at) for name, (_, log) in true.items()}
    given = {
        name: Times(log - behind[name], stamp - behind[name]) for name, (stamp, log) in true.items()
    }
    for name, found in mend_clocks(given).items():
        assert found.steps and abs(found.log_ns - true[name][1]).max() < 25 * MS
        assert abs(found.stamp_ns - true[name][0]).max() < 25 * MS


def test_a_clock_that_returns_is_followed():
    stamp, log = _stream(np.random.default_rng(0), 20.0)
    number = np.arange(len(stamp))
    found = _mended(log, stamp - 2000 * MS * ((number >= 300) & (number < 700)))
    assert [(step.row, step.by_ns > 0) for step in found.steps] == [(300, True), (700, False)]
    assert abs(found.stamp_ns - stamp).max() < 2 * MS


def test_late_parts_late_messages_and_backlogs_are_no_steps():
    rng = np.random.default_rng(1)
    stamp, log = _stream(rng, 20.0)
    number = np.arange(len(stamp))
    part_written_late = np.concatenate([number[:100], number[200:300], number[100:200]])
    one_late = np.insert(np.delete(number, 500), 530, 500)
    few_wrong = stamp - 1000 * MS * ((number >= 400) & (number < 410))
    backlog = np.delete(number, np.arange(500, 560))
    held = log + 1200 * MS * (number < 560)
    late_publisher = stamp + rng.integers(0, 400 * MS, len(stamp)) * (number % 2)
    arrived = np.argsort(late_publisher, kind="stable")
    cases = {
        "a part written late": (log[part_written_late], stamp[part_written_late]),
        "one message written late": (log[one_late], stamp[one_late]),
        "a late message": (log, stamp[one_late]),
        "few stamps wrong": (log, few_wrong),
        "a backlog that was dropped": (held[backlog], stamp[backlog]),
        "a second publisher": (late_publisher[arrived], stamp[arrived]),
        "reversed": (log[::-1], stamp[::-1]),
        "constant": (log, np.full_like(stamp, T0)),
        "years off at the end": (log, np.where(number < 900, stamp, 1)),
        "nothing": (log[:0], stamp[:0]),
        "one": (log[:1], stamp[:1]),
    }
    for name, (logged, stamped) in cases.items():
        found = _mended(logged, stamped)
        assert not found.steps, name
        np.testing.assert_array_equal(found.stamp_ns, stamped)


def test_times_of_a_second_topic_are_no_step():
    stamp, log = _stream(np.random.default_rng(2), 20.0)
    twice = Times(np.concatenate([log, log]), np.concatenate([stamp, stamp]), (len(log),))
    assert not mend_clocks({"one": twice})["one"].steps

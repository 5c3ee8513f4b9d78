"""Selection of a stream's clock, and handling of wrong stamps."""

import numpy as np
import pytest

from bodylog.recording.clocks import (
    is_sound,
    largest_gap,
    order_by_time,
    repeats_earlier_times,
    seconds_since,
)

T0 = 1_700_000_000_000_000_000
MS = 1_000_000


def test_order_by_time_prefers_a_moving_header():
    stamp = T0 + 20 * MS * np.arange(50)
    timing = order_by_time(stamp + 4 * MS, stamp, "auto")
    assert timing.clock == "header"
    np.testing.assert_array_equal(timing.t_ns, stamp)
    assert (timing.offset_ns, timing.spread_s) == (4 * MS, 0)


@pytest.mark.parametrize("apart", [1, T0 - 7, 7 - T0])
def test_order_by_time_offset_is_exact_for_distant_clocks(apart):
    stamp = T0 + 20 * MS * np.arange(101)
    timing = order_by_time(stamp + apart + MS * np.arange(101), stamp, "header")
    assert (timing.offset_ns, timing.spread_s) == (apart + 50 * MS, pytest.approx(0.09))


@pytest.mark.parametrize("stamp", [np.zeros(50, np.int64), np.full(50, T0), None])
def test_order_by_time_uses_the_log_without_a_usable_header(stamp):
    log = T0 + 20 * MS * np.arange(50)
    timing = order_by_time(log, stamp, "auto")
    assert timing.clock == "log"
    np.testing.assert_array_equal(timing.t_ns, log)


@pytest.mark.parametrize("later", [1000, 6 * MS])
def test_order_by_time_accepts_stamps_shared_by_two_publishers(later):
    stamp = np.repeat(T0 + 20 * MS * np.arange(50), 2)
    log = stamp + 4 * MS + np.tile([0, later], 50)
    timing = order_by_time(log, stamp, "auto")
    assert timing.clock == "header" and timing.rejected == {"same stamp again": 50}


@pytest.mark.parametrize("by", [2, 30])
def test_order_by_time_uses_a_rising_header_when_the_log_clock_is_set_back(by):
    stamp = T0 + 20 * MS * np.arange(1000)
    log = stamp + 4 * MS - by * 1000 * MS * (np.arange(1000) > 400)
    timing = order_by_time(log, stamp, "auto")
    assert timing.clock == "header" and not timing.rejected and not len(timing.backwards)
    np.testing.assert_array_equal(timing.t_ns, stamp)
    assert order_by_time(stamp + 4 * MS, log, "auto").clock == "log"


def test_order_by_time_rejects_a_slow_header_clock():
    log = T0 + 20 * MS * np.arange(50)
    assert order_by_time(log, T0 + (log - T0) // (100 * MS) * (100 * MS), "auto").clock == "log"


def test_order_by_time_follows_an_explicit_choice():
    stamp = T0 + 20 * MS * np.arange(50)
    assert order_by_time(stamp + 4 * MS, stamp, "log").t_ns[0] == T0 + 4 * MS
    assert order_by_time(stamp + 4 * MS, np.zeros(50, np.int64), "header", distinct=False).clock == "header"


@pytest.mark.parametrize("seed", range(5))
def test_order_by_time_sorts_and_counts_shuffled_messages(seed):
    rng = np.random.default_rng(seed)
    order = rng.permutation(200)
    t = T0 + 10 * MS * order
    timing = order_by_time(t, None, "auto")
    np.testing.assert_array_equal(timing.t_ns, np.sort(t))
    np.testing.assert_array_equal(order[timing.rows], np.arange(200))
    assert timing.out_of_order == (np.diff(t) < 0).sum()


def test_order_by_time_keeps_the_first_of_equal_stamps():
    t = T0 + MS * np.array([0, 2, 1, 2, 3, 2])
    timing = order_by_time(t, None, "auto")
    assert timing.rows.tolist() == [0, 2, 1, 4]
    assert timing.rejected == {"same stamp again": 2}
    assert order_by_time(t, None, "auto", distinct=False).rows.tolist() == [0, 2, 1, 3, 5, 4]


@pytest.mark.parametrize("wrong", [0, 5 * MS, T0 // 2, 2 * T0, -T0])
def test_order_by_time_rejects_one_message_years_off(wrong):
    t = np.insert(T0 + 10 * MS * np.arange(40), 17, wrong)
    timing = order_by_time(t, None, "auto")
    assert (len(timing.t_ns), timing.rejected) == (40, {"time years away": 1})
    assert 17 not in timing.rows


def test_order_by_time_rejects_time_zero_of_two_messages():
    assert order_by_time(np.array([0, T0]), None, "auto").t_ns.tolist() == [T0]


def test_order_by_time_accepts_clocks_starting_in_1970():
    t = 20 * MS * np.arange(50)
    assert len(order_by_time(t, None, "auto").t_ns) == 50


def test_order_by_time_keeps_both_days():
    t = np.concatenate([T0 + MS * np.arange(60), T0 + 3 * 86_400_000 * MS + MS * np.arange(40)])
    assert len(order_by_time(t, None, "auto").t_ns) == 100


def test_order_by_time_accepts_no_messages():
    empty = np.empty(0, np.int64)
    timing = order_by_time(empty, empty, "auto")
    assert (len(timing.t_ns), timing.offset_ns) == (0, None)
    assert not is_sound(empty)
    assert largest_gap(empty) == 0


def test_seconds_keep_nanoseconds():
    t = T0 + np.array([0, 1, 123_456_789])
    np.testing.assert_array_equal(seconds_since(t, T0), [0.0, 1e-9, 0.123456789])


def test_largest_gap_is_the_longest_step():
    assert largest_gap(T0 + MS * np.array([0, 1, 11, 12])) == pytest.approx(0.010)


def test_order_by_time_uses_the_log_if_the_header_is_set_back():
    log = T0 + 20 * MS * np.arange(300) + 4 * MS
    stamp = log - 4 * MS - 2000 * MS * (np.arange(300) >= 150)
    timing = order_by_time(log, stamp, "auto")
    assert (timing.clock, timing.rejected) == ("log", {})
    np.testing.assert_array_equal(timing.t_ns, log)
    assert len(timing.backwards) == 150
    insisted = order_by_time(log, stamp, "header")
    assert (insisted.clock, insisted.rejected) == ("header", {"time runs backwards": 99, "same stamp again": 1})


def test_order_by_time_uses_the_log_if_the_header_is_reversed():
    log = T0 + 20 * MS * np.arange(300)
    timing = order_by_time(log, log[::-1] - 4 * MS, "auto")
    assert timing.clock == "log" and len(timing.backwards) > 270
    np.testing.assert_array_equal(timing.t_ns, log)


@pytest.mark.parametrize("astray_s", [-30.003, -1.0, 1.0, 30.003])
def test_order_by_time_rejects_few_messages_far_from_the_rest(astray_s):
    log = T0 + 20 * MS * np.arange(300)
    wrong = (np.arange(300) >= 100) & (np.arange(300) < 110)
    stamp = log - 4 * MS + round(astray_s * 1000) * MS * wrong
    timing = order_by_time(log, stamp, "auto")
    assert (timing.clock, timing.rejected) == ("header", {"time runs backwards": 10})
    np.testing.assert_array_equal(timing.rows, np.flatnonzero(~wrong))
    np.testing.assert_array_equal(timing.backwards, log[wrong])


@pytest.mark.parametrize("seed", range(3))
def test_order_by_time_sorts_late_messages_of_a_second_publisher(seed):
    rng = np.random.default_rng(seed)
    stamp = np.sort(np.concatenate([T0 + 20 * MS * np.arange(300), T0 + MS + 20 * MS * np.arange(300)]))
    log = stamp + rng.integers(0, 400 * MS, 600) * (np.arange(600) % 2)
    order = np.argsort(log, kind="stable")
    timing = order_by_time(log[order], stamp[order], "auto")
    assert (timing.clock, timing.rejected, len(timing.backwards)) == ("header", {}, 0)
    np.testing.assert_array_equal(timing.t_ns, stamp)


@pytest.mark.parametrize("back_ms", [800, 2001])
def test_order_by_time_rejects_overlaps_after_the_log_clock_is_set_back(back_ms):
    t = T0 + 20 * MS * np.arange(300) - back_ms * MS * (np.arange(300) >= 150)
    for timing in (order_by_time(t, None, "auto"), order_by_time(t, t - 3 * MS, "auto")):
        twice = back_ms // 20
        assert timing.rejected["time runs backwards"] in (twice - 1, twice)
        assert timing.rows.tolist() == sorted(timing.rows) and len(timing.rows) >= 300 - twice - 1


def test_repeats_accepts_a_part_written_late():
    t = T0 + 20 * MS * np.concatenate([np.arange(100), np.arange(200, 300), np.arange(100, 200)])
    timing = order_by_time(t, None, "auto")
    assert (len(timing.t_ns), timing.rejected, timing.out_of_order) == (300, {}, 1)


def test_falls_detects_reversed_files():
    t = T0 + 20 * MS * np.arange(50)
    assert [order_by_time(given, None, "auto").falls for given in (t, t[::-1], t[:1], t[:0])] == [
        False,
        True,
        False,
        False,
    ]


def test_repeats_is_empty_for_a_constant_clock():
    assert not repeats_earlier_times(np.array([T0] * 99 + [T0 - 10_000 * MS])).any()

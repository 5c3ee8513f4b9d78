"""Which clock dates a stream, and what becomes of stamps that are wrong."""

import numpy as np
import pytest

from bodylog.logs.clocks import date, is_sound, largest_gap, seconds

T0 = 1_700_000_000_000_000_000
MS = 1_000_000


def test_the_header_is_preferred_when_it_moves():
    stamp = T0 + 20 * MS * np.arange(50)
    dated = date(stamp + 4 * MS, stamp, "auto")
    assert dated.clock == "header"
    np.testing.assert_array_equal(dated.t_ns, stamp)
    assert (dated.offset_ns, dated.spread_s) == (4 * MS, 0)


@pytest.mark.parametrize("apart", [1, T0 - 7, 7 - T0])
def test_offset_and_spread_are_exact_however_far_the_clocks_are_apart(apart):
    stamp = T0 + 20 * MS * np.arange(101)
    dated = date(stamp + apart + MS * np.arange(101), stamp, "header")
    assert (dated.offset_ns, dated.spread_s) == (apart + 50 * MS, pytest.approx(0.09))


@pytest.mark.parametrize("stamp", [np.zeros(50, np.int64), np.full(50, T0), None])
def test_the_log_is_used_when_the_header_is_unset_stuck_or_absent(stamp):
    log = T0 + 20 * MS * np.arange(50)
    dated = date(log, stamp, "auto")
    assert dated.clock == "log"
    np.testing.assert_array_equal(dated.t_ns, log)


def test_robot_toml_has_the_last_word():
    stamp = T0 + 20 * MS * np.arange(50)
    assert date(stamp + 4 * MS, stamp, "log").t_ns[0] == T0 + 4 * MS
    assert date(stamp + 4 * MS, np.zeros(50, np.int64), "header", distinct=False).clock == "header"


@pytest.mark.parametrize("seed", range(5))
def test_shuffled_messages_are_sorted_and_counted(seed):
    rng = np.random.default_rng(seed)
    order = rng.permutation(200)
    t = T0 + 10 * MS * order
    dated = date(t, None, "auto")
    np.testing.assert_array_equal(dated.t_ns, np.sort(t))
    np.testing.assert_array_equal(order[dated.rows], np.arange(200))
    assert dated.out_of_order == (np.diff(t) < 0).sum()


def test_of_equal_stamps_the_first_in_the_file_is_kept_and_the_rest_counted():
    t = T0 + MS * np.array([0, 2, 1, 2, 3, 2])
    dated = date(t, None, "auto")
    assert dated.rows.tolist() == [0, 2, 1, 4]
    assert dated.rejected == {"same stamp again": 2}
    assert date(t, None, "auto", distinct=False).rows.tolist() == [0, 2, 1, 3, 5, 4]


@pytest.mark.parametrize("wrong", [0, 5 * MS, T0 // 2, 2 * T0, -T0])
def test_one_message_years_away_is_rejected(wrong):
    t = np.insert(T0 + 10 * MS * np.arange(40), 17, wrong)
    dated = date(t, None, "auto")
    assert (len(dated.t_ns), dated.rejected) == (40, {"time years away": 1})
    assert 17 not in dated.rows


def test_two_messages_of_which_one_is_at_time_zero():
    assert date(np.array([0, T0]), None, "auto").t_ns.tolist() == [T0]


def test_clocks_starting_in_1970_are_no_outliers():
    t = 20 * MS * np.arange(50)
    assert len(date(t, None, "auto").t_ns) == 50


def test_a_log_of_two_days_keeps_both():
    t = np.concatenate([T0 + MS * np.arange(60), T0 + 3 * 86_400_000 * MS + MS * np.arange(40)])
    assert len(date(t, None, "auto").t_ns) == 100


def test_no_messages_at_all():
    empty = np.empty(0, np.int64)
    dated = date(empty, empty, "auto")
    assert (len(dated.t_ns), dated.offset_ns) == (0, None)
    assert not is_sound(empty)
    assert largest_gap(empty) == 0


def test_nanoseconds_survive_the_way_to_seconds():
    t = T0 + np.array([0, 1, 123_456_789])
    np.testing.assert_array_equal(seconds(t, T0), [0.0, 1e-9, 0.123456789])


def test_the_largest_gap():
    assert largest_gap(T0 + MS * np.array([0, 1, 11, 12])) == pytest.approx(0.010)

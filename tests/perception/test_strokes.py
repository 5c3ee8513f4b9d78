"""Strokes from drawn hand paths with known corners."""

import numpy as np
import pytest

from bodylog.perception.touch.strokes import find_strokes
from bodylog.types import Array, Series

CONTACTS = [(2.013, 2.9), (5.21, 6.437), (8.5, 9.32)]


def _path(t: Array, curved: bool) -> Array:
    """Approach, even contact along the limb, retreat another way; NaN in between."""
    place = np.full((len(t), 2), np.nan)
    for start, end in CONTACTS:
        before, after = np.minimum(t - start, 0.0), np.maximum(t - end, 0.0)
        along = np.clip(t, start, end) - start
        bend = 60.0 if curved else 0.0
        u = 160.0 - 40.0 * before + bend * before**2 + 35.0 * after + bend * after**2
        v = 100.0 + 55.0 * before - bend * before**2 - 28.0 * along - 50.0 * after - bend * after**2
        near = (t > start - 0.9) & (t < end + 0.9)
        place[near] = np.column_stack([u, v])[near]
    return place


def _track(rate: float, seed: int, curved: bool, noise: float = 0.1) -> Series:
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 11.0, 1 / rate) + rng.uniform(0, 1 / rate)
    place = _path(t, curved) + rng.normal(0.0, noise, (len(t), 2))
    return Series(t, place, ("u", "v"), "px", (t * 1e9).astype(np.int64))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("rate", [15.0, 20.0, 30.0])
@pytest.mark.parametrize("curved", [False, True])
def test_strokes_begin_and_end_within_half_a_frame(rate: float, seed: int, curved: bool) -> None:
    found = find_strokes(_track(rate, seed, curved))
    assert len(found) == len(CONTACTS)
    for stroke, (start, end) in zip(found, CONTACTS, strict=True):
        assert stroke.start == pytest.approx(start, abs=0.5 / rate)
        assert stroke.end == pytest.approx(end, abs=0.5 / rate)
        assert stroke.start_px == pytest.approx((160.0, 100.0), abs=2.0)


@pytest.mark.parametrize("seed", range(5))
def test_frames_lost_here_and_there_cost_no_stroke(seed: int) -> None:
    track = _track(20.0, seed, False)
    track.values[np.random.default_rng(100 + seed).random(len(track.t)) < 0.15] = np.nan
    found = find_strokes(track)
    assert len(found) == len(CONTACTS)
    for stroke, (start, end) in zip(found, CONTACTS, strict=True):
        assert stroke.start == pytest.approx(start, abs=0.05) and stroke.end == pytest.approx(end, abs=0.05)


def test_strokes_ignore_steady_resting_and_absent_hands() -> None:
    t = np.arange(0, 5, 0.05)
    source = (t * 1e9).astype(np.int64)
    noise = np.random.default_rng(0).normal(0.0, 0.1, (len(t), 2))
    for place in (np.column_stack([40 * t, 30 * t]), np.full((len(t), 2), 100.0), np.full((len(t), 2), np.nan)):
        assert find_strokes(Series(t, place + noise, ("u", "v"), "px", source)) == ()
    assert find_strokes(Series(t[:0], noise[:0], ("u", "v"), "px", source[:0])) == ()

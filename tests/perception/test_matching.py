"""Pairs of touches and strokes, their delays and weights."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from bodylog.errors import ConfigError
from bodylog.perception import observe_recording
from bodylog.perception.touch.matching import match_touches
from bodylog.settings import Settings
from bodylog.types import Stroke, Touch
from tests.work import at_most

SHARED = Path(__file__).parents[2].parent / "shared" / "logs"


def _touches(seed: int, count: int = 30) -> list[Touch]:
    rng = np.random.default_rng(seed)
    onsets = np.cumsum(rng.uniform(1.8, 3.2, count))
    return [Touch(t, t + rng.uniform(0.7, 1.1), (5,), 0.9, 5, round(t * 1e9)) for t in onsets.tolist()]


def _strokes(touches: Sequence[Touch], delays: Sequence[float]) -> list[Stroke]:
    pairs = zip(touches, delays, strict=True)
    return [Stroke(touch.onset + late, touch.offset + late, (0.0, 0.0), (9.0, 9.0)) for touch, late in pairs]


@pytest.mark.parametrize("seed", range(5))
def test_jitter_of_a_tenth_counts_as_synchronous_and_of_a_second_does_not(seed: int) -> None:
    touches, rng = _touches(seed), np.random.default_rng(seed)
    for most, low, high in [(0.1, 0.75, 1.0), (1.0, 0.0, 0.25)]:
        delays = rng.uniform(0.0, most, len(touches))
        found, _ = match_touches(touches, _strokes(touches, delays.tolist()))
        assert [pair.stroke for pair in found] == list(range(len(touches)))
        assert np.allclose([pair.delay for pair in found], delays)
        assert low < np.mean([pair.weight for pair in found]) <= high


def test_match_weight_falls_with_delay() -> None:
    touches = _touches(0)
    for delay, low, high in [(0.0, 1.0, 1.0), (1 / 15, 0.8, 0.9), (0.6, 0.0, 0.1), (-0.6, 0.0, 0.1)]:
        found, _ = match_touches(touches, _strokes(touches, [delay] * len(touches)))
        assert all(low - 1e-9 <= pair.weight <= high + 1e-9 for pair in found)


def test_match_keeps_order_and_unpaired_touches() -> None:
    touches = _touches(1, 6)
    strokes = _strokes(touches, [0.05] * 6)
    del strokes[2]
    found, _ = match_touches(touches, [*strokes, Stroke(99.0, 99.5, (0.0, 0.0), (5.0, 5.0))])
    assert [pair.stroke for pair in found] == [0, 1, None, 2, 3, 4]
    assert np.isnan(found[2].delay) and found[2].weight == 0.0
    assert match_touches([], strokes)[0] == () and match_touches(touches, [])[0][0].stroke is None


def test_match_looks_only_at_strokes_near_a_touch() -> None:
    touches = _touches(3, 400)
    strokes = _strokes(touches, [0.05] * 400)
    with at_most(calls=100 * len(touches)):
        found, _ = match_touches(touches, strokes)
    assert [pair.stroke for pair in found] == list(range(400))


def test_match_costs_the_least_of_all_orders() -> None:
    """Beside a table of all touches and all strokes."""
    rng = np.random.default_rng(4)
    for _ in range(30):
        touches = _touches(int(rng.integers(100)), int(rng.integers(1, 12)))
        strokes = _strokes(touches, rng.normal(0.0, 0.8, len(touches)).tolist())
        kept = sorted(strokes, key=lambda stroke: stroke.start)[:: int(rng.integers(1, 3))]
        found, _ = match_touches(touches, kept)
        cost = _cost(touches, kept, [pair.stroke for pair in found])
        assert cost == pytest.approx(_least(touches, kept))


def _apart(touch: Touch, stroke: Stroke) -> float:
    return 0.5 * (abs(stroke.start - touch.onset) + abs(stroke.end - touch.offset))


def _cost(touches: list[Touch], strokes: list[Stroke], partners: list[int | None]) -> float:
    pairs = [(i, j) for i, j in enumerate(partners) if j is not None]
    alone = len(touches) + len(strokes) - 2 * len(pairs)
    return 0.75 * alone + sum(_apart(touches[i], strokes[j]) for i, j in pairs)


def _least(touches: Sequence[Touch], strokes: Sequence[Stroke]) -> float:
    """The least cost by dynamic programming over all of them."""
    row = [0.75 * count for count in range(len(strokes) + 1)]
    for touch in touches:
        before, row = row, [row[0] + 0.75]
        for j, stroke in enumerate(strokes):
            row.append(min(before[j] + _apart(touch, stroke), before[j + 1] + 0.75, row[j] + 0.75))
    return row[-1]


def test_match_corrects_a_constant_latency_only_if_configured() -> None:
    touches = _touches(2)
    late = _strokes(touches, [0.6] * len(touches))
    kept, reported = match_touches(touches, late)
    assert all(pair.weight < 0.1 for pair in kept)
    assert "0.600 s after the skin feels them" in reported[0].text and "--clock-offset auto" in reported[0].text
    for offset in ("auto", 0.6, "0.6"):
        freed, _ = match_touches(touches, late, clock_offset=offset)
        assert all(abs(pair.delay) < 1e-9 and pair.weight > 0.99 for pair in freed)


def test_unsteady_delays_are_no_clock_offset() -> None:
    touches = _touches(3)
    delays = np.random.default_rng(3).uniform(0.0, 1.0, len(touches))
    found, reported = match_touches(touches, _strokes(touches, delays.tolist()), clock_offset="auto")
    assert np.allclose([pair.delay for pair in found], delays)
    assert reported[0].severity == "warning" and "none subtracted" in reported[0].text


def test_match_refuses_an_invalid_offset() -> None:
    with pytest.raises(ConfigError, match=r"synchrony\.clock_offset: found 'soon'; possible: auto, or seconds"):
        match_touches([], [], clock_offset="soon")


@pytest.mark.parametrize(("log", "delay"), [("touch.mcap", 0.0), ("touch_async.mcap", 0.6)])
def test_touches_of_the_arm_logs_are_dated_and_judged(log: str, delay: float) -> None:
    from bodylog.recording.recording import read_recording

    path = SHARED / "arm" / log
    if not path.exists():
        pytest.skip(f"{path} is not here")
    truth = np.load(f"{path}.truth.npz")["touches"]
    features = observe_recording(read_recording(path, Settings()), Settings())
    assert features.touches is not None and len(features.touches) == len(features.strokes) == len(truth)
    for touch, pair, (onset, offset, cell) in zip(features.touches, features.synchrony, truth, strict=True):
        assert touch.onset == pytest.approx(onset, abs=0.015) and touch.offset == pytest.approx(offset, abs=0.015)
        assert touch.strongest == cell
        assert pair.delay == pytest.approx(delay, abs=1 / 15)
        assert pair.weight > 0.8 if delay == 0 else pair.weight < 0.1

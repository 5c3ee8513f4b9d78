"""Touches from drawn skin readings with known onsets."""

import numpy as np
import pytest

from bodylog.perception import observe_recording
from bodylog.perception.touch import detection
from bodylog.settings import Settings, SkinSettings
from bodylog.types import Array, Series
from tests.perception import scenes

CELLS = 117
T = np.arange(1000) / 100.0


def _rest(seed: int) -> Array:
    return 0.08 + np.random.default_rng(seed).normal(0.0, 0.015, (len(T), CELLS))


def _press(values: Array, cell: int, onset: float, offset: float, peak: float = 0.95) -> None:
    """A cell and its weaker neighbours cross 0.7 of full scale at onset and offset, within some 20 ms each."""
    for away, share in {0: 1.0, 1: 0.85, -1: 0.85}.items():
        rise = np.clip((T - onset) / 0.04 + 0.7, 0, 1) * np.clip((offset - T) / 0.04 + 0.7, 0, 1)
        values[:, cell + away] += share * (peak - 0.08) * rise


def _series(values: Array) -> Series:
    names = tuple(map(str, range(values.shape[1])))
    return Series(T[: len(values)], values, names, "", (T[: len(values)] * 1e9).astype(np.int64))


@pytest.mark.parametrize("seed", range(5))
def test_touches_match_the_drawn_touches_and_onsets(seed: int) -> None:
    values = _rest(seed)
    given = [(1.003, 1.8, 10), (3.0, 3.318, 60), (3.05, 3.4, 90), (6.0, 8.007, 115)]
    for onset, offset, cell in given:
        _press(values, cell, onset, offset)
    touches, health, findings = detection.detect_touches(_series(values), SkinSettings())
    assert touches is not None and len(touches) == len(given)
    for touch, (onset, offset, cell) in zip(touches, given, strict=True):
        assert touch.onset == pytest.approx(onset, abs=0.015)
        assert touch.offset == pytest.approx(offset, abs=0.015)
        assert touch.strongest == cell and set(touch.cells) <= {cell - 1, cell, cell + 1}
        assert 0.9 < touch.peak <= 1.1
        assert abs(touch.source_ns / 1e9 - touch.onset) <= 0.011
    assert health.used == len(T) and not findings


def test_touches_join_readings_above_the_release_level() -> None:
    values = _rest(0)
    values[200:300, 50] = np.where(np.arange(100) % 10 < 5, 0.9, 0.65)
    touches, _, _ = detection.detect_touches(_series(values), SkinSettings())
    assert touches is not None and len(touches) == 1
    more, _, _ = detection.detect_touches(_series(values), SkinSettings(release=0.69))
    assert more is not None and len(more) == 1, "pauses below 50 ms do not part a touch"


def test_touches_ignore_spikes_below_the_shortest() -> None:
    values = _rest(0)
    values[200, 50] = 0.95
    touches, _, _ = detection.detect_touches(_series(values), SkinSettings(shortest=0.03))
    assert touches == ()


def test_touches_join_a_stroke_across_cells() -> None:
    values = _rest(0)
    for step in range(8):
        values[200 + 10 * step : 215 + 10 * step, 40 + step] = 0.9
    touches, _, _ = detection.detect_touches(_series(values), SkinSettings())
    assert touches is not None and [touch.cells for touch in touches] == [tuple(range(40, 48))]


def test_rows_of_cells_neighbour_across_rows_where_columns_are_given() -> None:
    values = _rest(0)
    values[200:300, 40] = values[200:300, 53] = 0.9
    apart, _, _ = detection.detect_touches(_series(values), SkinSettings())
    together, _, _ = detection.detect_touches(_series(values), SkinSettings(columns=13))
    assert apart is not None and together is not None
    assert (len(apart), len(together)) == (2, 1)


def test_silence_ends_a_touch() -> None:
    values = _rest(0)
    values[200:400, 50] = 0.9
    series = _series(values)
    late = Series(np.where(T < 3.0, T, T + 2.0), series.values, series.names, "", series.source_ns)
    touches, health, _ = detection.detect_touches(late, SkinSettings())
    assert touches is not None and [round(touch.onset, 1) for touch in touches] == [2.0, 5.0]
    assert touches[0].offset <= 3.0
    assert health.largest_gap_s == pytest.approx(2.01)


def test_touches_names_and_ignores_dead_and_constantly_touched_cells() -> None:
    values = _rest(0)
    values[:, 7] = 0.0
    values[:, 30] = 0.97 + 0.01 * np.sin(T)
    _press(values, 60, 3.0, 4.0)
    touches, _, findings = detection.detect_touches(_series(values), SkinSettings())
    assert touches is not None and len(touches) == 1
    texts = [finding.text for finding in findings]
    assert any("1 of 117 cells (7)" in text and "dead" in text for text in texts)
    assert any("1 of 117 cells (30)" in text and "stuck" in text for text in texts)


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_touches_rejects_constant_skin_with_a_warning(level: float) -> None:
    features = observe_recording(scenes.recording(skin=_series(np.full((500, CELLS), level))), Settings())
    assert features.touches is None
    assert any(f"all 117 cells read {level:g} from first to last" in finding.text for finding in features.findings)


def test_readings_that_are_not_numbers_are_untouched_and_counted() -> None:
    values = _rest(0)
    _press(values, 60, 3.0, 4.0)
    values[700:710] = np.nan
    touches, health, findings = detection.detect_touches(_series(values), SkinSettings())
    assert touches is not None and len(touches) == 1
    assert health.rejected == {"not a number": 10}
    assert "1.0% of the readings are not numbers" in findings[0].text


def test_touches_report_a_skin_without_readings() -> None:
    touches, health, findings = detection.detect_touches(_series(np.zeros((0, CELLS))), SkinSettings())
    assert touches is None and health.seen == 0 and "no readings" in findings[0].text

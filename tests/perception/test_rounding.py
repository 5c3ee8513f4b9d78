"""Sums of squares less squares of sums: what is measured must not drown in their rounding, on any processor."""

import numpy as np
import pytest

from bodylog.perception.colours.subpixel_centroid import measure_centroids
from bodylog.perception.touch import strokes
from bodylog.perception.tracking import target_selection
from bodylog.types import Array


def _discs(seed: int, count: int = 32) -> tuple[Array, Array, Array]:
    """Discs of one colour on a ground of another, without noise: (S,K,S,3), (S,K,S), and their pixels' means (K,2)."""
    rng = np.random.default_rng(seed)
    side = 8 * int(rng.integers(4, 12))
    sheet, core = np.empty((side, count, side, 3), np.uint8), np.zeros((side, count, side), np.uint8)
    y, x = np.mgrid[:side, :side]
    centres = []
    for k in range(count):
        ground, disc = rng.integers(0, 256, (2, 3))
        u, v = side / 2 - 0.5 + rng.uniform(-1, 1, 2)
        inside = np.hypot(x - u, y - v) < rng.uniform(4, side / 2 - 9)
        sheet[:, k], core[:, k] = np.where(inside[..., None], disc, ground), inside
        centres.append((x[inside].mean(), y[inside].mean()))
    return sheet, core, np.array(centres)


@pytest.mark.parametrize("seed", range(10))
def test_centres_of_discs_without_noise_are_exact(seed: int) -> None:
    sheet, core, centres = _discs(seed)
    u, v, std_u, std_v, mass, _ = measure_centroids(sheet, core, np.ones_like(core))
    assert np.abs(np.column_stack([u, v]) - centres).max() < 1e-6
    assert np.isfinite([std_u, std_v]).all()
    assert mass == pytest.approx(core.sum(axis=(0, 2)))


def test_errors_of_a_path_are_the_same_late_in_a_long_track() -> None:
    t = np.arange(60_000) / 30.0
    place = np.column_stack([100.0 + 100.0 * np.sin(3.0 * t), 200.0 + 50.0 * np.cos(2.0 * t)])
    late = [*strokes._squared_errors_by_end(t, place, 8)][-90:]
    alone = [*strokes._squared_errors_by_end(t[-400:], place[-400:], 8)][-90:]
    assert np.concatenate(late) == pytest.approx(np.concatenate(alone), abs=1e-6)


def test_a_views_usual_area_is_the_same_late_in_a_long_log() -> None:
    rng = np.random.default_rng(6)
    t = np.arange(300) / 29.3  # no image stands upon the border of another one's window
    area = 400.0 + 30.0 * np.sin(t) + rng.normal(0, 2, len(t))
    weight = np.ones(len(t))
    early = target_selection._values_on_local_lines(t, area, weight)
    for begin in (1e5, 1e7):
        before = np.arange(begin - 100.0, begin, 0.1)
        whole = np.concatenate([before, begin + t])
        late = target_selection._values_on_local_lines(whole, np.append(np.full(len(before), 400.0), area), np.ones(len(whole)))
        assert late[len(before) + 20 :] == pytest.approx(early[20:], abs=1e-4)

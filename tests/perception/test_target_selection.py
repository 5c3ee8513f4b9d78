"""Blobs linked to runs: a single blob's stretch at once, as frame by frame."""

import numpy as np
import pytest

from bodylog.perception.colours.coarse_search import CANDIDATES
from bodylog.perception.tracking import target_selection
from bodylog.types import Array


def _found(rng: np.random.Generator, others: float) -> tuple[Array, Array]:
    """Times (N,) s and blobs (N,CANDIDATES,7) of one that wanders; of some frames none, of a share `others` several."""
    count = int(rng.integers(2, 200))
    t = np.cumsum(rng.exponential(rng.uniform(0.02, 0.2), count))
    place = 200 + np.cumsum(rng.normal(0, rng.uniform(1, 15), (count, 2)), axis=0)
    found = np.full((count, CANDIDATES, 7), np.nan)
    many = np.where(rng.random(count) < others, rng.integers(0, CANDIDATES + 1, count), 1)
    for frame, blobs in enumerate(many.tolist()):
        beside = rng.normal(0, 60, (blobs, 2)) * (np.arange(blobs) > 0)[:, None]
        mass = 100 * np.exp(rng.normal(0, 0.3, blobs))
        at_border = rng.random(blobs) < 0.05
        found[frame, :blobs] = np.column_stack([place[frame] + beside, 0.1 + 0 * beside, mass, 9 * mass, at_border])
    return t, found


@pytest.mark.parametrize("others", [0.02, 0.2, 0.9])
@pytest.mark.parametrize("count", [10, pytest.param(40, marks=pytest.mark.soak)])
def test_stretches_are_linked_as_frame_by_frame(others: float, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(int(100 * others))
    logs = [_found(rng, others) for _ in range(count)]
    at_once = [target_selection.select_target(t, found, 320.0) for t, found in logs]
    monkeypatch.setattr(target_selection, "_last_single_frames", lambda t, found, reach: list(range(len(t))))
    for (t, found), (track, why) in zip(logs, at_once, strict=True):
        one_by_one = target_selection.select_target(t, found, 320.0)
        np.testing.assert_array_equal(track, one_by_one[0])
        np.testing.assert_array_equal(why, one_by_one[1])
    assert any(np.isfinite(track).any() for track, _ in at_once)

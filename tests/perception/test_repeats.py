"""Frames that repeat their predecessor: stored twice exactly, coded again, and what is no repeat."""

from collections.abc import Iterator

import numpy as np
import pytest

from bodylog.perception.surface.repeats import FrameRepeats, RepeatSearch, shrunken_frames
from bodylog.types import Array, LazyImage


def scene(place: float, noise: float, rng: np.random.Generator) -> Array:
    """A textured bar (h,w) at a place, px, before a grey wall, with noise of a coder, grey levels."""
    image = np.full((60, 80), 90.0)
    texture = 60.0 * np.sin(0.3 * (np.arange(80) - place))
    image[20:40] += texture * np.exp(-np.square((np.arange(80) - place) / 12.0))
    return np.clip(image + noise * rng.standard_normal(image.shape), 0, 255).astype(np.uint8)


def judged(places: Array, noise: float = 0.0, seed: int = 0) -> FrameRepeats:
    rng, search = np.random.default_rng(seed), RepeatSearch()
    for n, place in enumerate(places):
        search.add(n / 30.0, scene(float(place), noise, rng))
    return search.repeats()


@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("copies", [2, 3, 4, 6])
def test_camera_stored_several_times(copies: int, noise: float) -> None:
    fresh = 40 + 20 * np.sin(0.25 * np.arange(60))
    found = judged(np.repeat(fresh, copies), noise)
    truth = np.arange(60 * copies) % copies > 0
    assert found.share == pytest.approx(1 - 1 / copies, abs=0.05)
    assert found.distinct_hz == pytest.approx(30.0 / copies, rel=0.1)
    assert not (found.repeated & ~truth).any()
    assert found.repeated[truth].mean() > 0.8


@pytest.mark.parametrize("seed", range(4))
def test_a_camera_stored_four_times_before_motions_with_pauses(seed: int) -> None:
    fresh = 30 + 8.0 * np.cumsum(np.tile([1, 1, 0, 0, 0, 1, -1, -1, 0, 0, -1], 8))
    found = judged(np.repeat(fresh, 4), 1.0, seed)
    truth = np.arange(len(fresh) * 4) % 4 > 0
    assert not (found.repeated & ~truth).any()
    assert found.share is not None and found.share > 0.65


@pytest.mark.parametrize("seed", range(4))
def test_some_frames_twice(seed: int) -> None:
    rng = np.random.default_rng(seed)
    twice = rng.random(80) < 0.25
    counts = np.where(twice, 2, 1)
    to_and_fro = 20 + 2.0 * np.abs((np.arange(80) + 20) % 40 - 20)
    found = judged(np.repeat(to_and_fro, counts), 1.0, seed)
    truth = np.concatenate([[False] + [True] * (count - 1) for count in counts])
    assert not (found.repeated & ~truth).any()
    assert found.repeated[truth].mean() > 0.9


@pytest.mark.parametrize("seed", range(4))
def test_stops_and_reversals_repeat_nothing(seed: int) -> None:
    t = np.arange(240) / 30.0
    stops = np.cumsum(np.maximum(np.sin(2 * np.pi * 0.7 * t), 0.0) * 3.0)
    swings = 40 + 20 * np.sin(2 * np.pi * 0.5 * t)
    for places in (20 + stops % 40, swings):
        assert judged(places, 1.0, seed).repeated.sum() == 0


def test_still_scene_says_nothing() -> None:
    found = judged(np.full(50, 40.0), 1.0)
    assert found.share is None
    assert found.distinct_hz == pytest.approx(30.0)


def test_frozen_camera_repeats_everything() -> None:
    found = judged(np.full(50, 40.0))
    assert found.share == 1.0
    assert found.distinct_hz == pytest.approx(0.0)


def test_frames_of_a_log() -> None:
    places = np.repeat(40 + 20 * np.sin(0.25 * np.arange(40)), 2)
    rng = np.random.default_rng(1)
    images = [scene(float(place), 0.0, rng) for place in places]

    def frames() -> Iterator[LazyImage]:
        for n, image in enumerate(images):
            big = np.repeat(np.repeat(image, 4, 0), 4, 1)
            yield LazyImage(n / 30.0, n, lambda k, big=big: np.dstack([big[::k, ::k]] * 3))

    search = RepeatSearch()
    for t, small in shrunken_frames(frames()):
        search.add(t, small)
    found = search.repeats()
    assert found.share == pytest.approx(0.5, abs=0.05)

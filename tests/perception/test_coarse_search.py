"""Where pictures lie in memory, and in which order their channels, does not show in what is found in them."""

import cv2
import numpy as np
import pytest

from bodylog.perception.colours import blob_measurement, coarse_search
from bodylog.perception.colours.hsv_ranges import range_between, resolve_colour
from bodylog.types import Array

from . import scenes

RANGES = [resolve_colour("green", "effector"), resolve_colour("red", "hand")]


def _kept(picture: Array) -> dict[str, Array]:
    """One picture as logs keep it."""
    rgb = np.ascontiguousarray(picture[..., ::-1])
    padded = np.pad(rgb, ((0, 0), (0, 7), (0, 0)))[:, : picture.shape[1]]
    four = np.dstack([picture, np.full(picture.shape[:2], 77, np.uint8)])
    high = np.stack([np.zeros_like(picture), picture], axis=-1).reshape(*picture.shape[:2], 6)
    kept = {"rgb8": rgb[..., ::-1], "rgb8, padded": padded[..., ::-1], "bgra8": four[..., :3], "bgr16": high[..., 1::2]}
    for one in kept.values():
        one.flags.writeable = False
    return kept


@pytest.mark.parametrize("size", [(120, 90), (320, 240), (640, 480), (643, 37), (1, 1), (700, 2)])
def test_blobs_are_the_same(size: tuple[int, int]) -> None:
    rng, (width, height) = np.random.default_rng(size[0]), size
    discs = [scenes.Disc(0.3 * width, 0.4 * height, 11.0), scenes.Disc(0.7 * width, 0.5 * height, 9.0, scenes.RED)]
    picture = scenes.draw(scenes.wall(rng, width, height, 4.0), discs, rng)
    expected = blob_measurement.measured_blobs([picture], RANGES)
    for form, kept in _kept(picture).items():
        np.testing.assert_array_equal(kept, picture, form)
        np.testing.assert_array_equal(blob_measurement.measured_blobs([kept], RANGES), expected, form)
    assert np.isfinite(expected[0, :, 0]).all() or min(size) < 90


def test_windows_keep_no_picture() -> None:
    rng = np.random.default_rng(1)
    picture = scenes.draw(scenes.wall(rng, 320, 240, 4.0), [scenes.Disc(160, 120, 11.0)], rng)
    for kept in (picture, *_kept(picture).values()):
        found = list(coarse_search.find_windows({0: kept}, RANGES))
        assert found and not any(np.shares_memory(window.pixels, kept) for window in found)


@pytest.mark.parametrize("seed", range(3))
def test_pictures_searched_together_show_what_each_alone_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pictures: list[Array] = []
    for number, (width, height) in enumerate([(320, 240), (320, 240), (160, 120), (320, 240), (160, 120), (120, 160)]):
        # above and below, where the next picture begins
        discs = [scenes.Disc(rng.uniform(0, width), v, 14.0) for v in (0.0, height - 1.0)]
        picture = scenes.draw(scenes.wall(rng, width, height, 4.0), discs, rng)
        pictures.append(list(_kept(picture).values())[number % 2])
    together, count = list(coarse_search.find_windows(dict(enumerate(pictures)), RANGES)), 0
    for number, picture in enumerate(pictures):
        alone = list(coarse_search.find_windows({number: picture}, RANGES))
        same = [window for window in together if window.picture == number]
        count += len(same)
        for ours, expected in zip(same, alone, strict=True):
            assert ours[:5] == expected[:5]
            np.testing.assert_array_equal(ours.pixels, expected.pixels)
    assert count == len(together) >= 2 * len(pictures)


@pytest.mark.parametrize("seed", range(3))
def test_narrow_ranges_are_found_wherever_they_lie_among_the_colours(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for h, s, v in rng.integers((0, 120, 80), (180, 256, 256), (40, 3)).tolist():
        b, g, r = cv2.cvtColor(np.array([[[h, s, v]]], np.uint8), cv2.COLOR_HSV2BGR)[0, 0].tolist()
        picture = scenes.draw(scenes.wall(rng, 160, 120, 4.0), [scenes.Disc(80, 60, 9.0, (b, g, r))], rng)
        low, high = (max(s - 30, 90), max(v - 30, 50)), (min(s + 30, 255), min(v + 30, 255))
        about = range_between(((h - 4) % 180, *low), ((h + 4) % 180, *high))
        found = blob_measurement.measured_blobs([picture], [about])[0, 0, 0]
        assert np.hypot(*(found[:2] - (80, 60))) < 0.5, (h, s, v)


def test_windows_separates_any_number_of_colours() -> None:
    rng = np.random.default_rng(2)
    hues = range(0, 180, 10)
    paints = [cv2.cvtColor(np.array([[[h, 220, 200]]], np.uint8), cv2.COLOR_HSV2BGR)[0, 0].tolist() for h in hues]
    places = [(40 + 60 * (k % 6), 40 + 60 * (k // 6)) for k in range(len(hues))]
    discs = [scenes.Disc(*at, 10.0, (b, g, r)) for at, (b, g, r) in zip(places, paints, strict=True)]
    picture = scenes.draw(scenes.wall(rng, 400, 240, 2.0), discs, rng, noise=0.5)
    wanted = [range_between(((h - 4) % 180, 90, 50), ((h + 4) % 180, 255, 255)) for h in hues]
    found = blob_measurement.measured_blobs([picture], wanted)[0, :, 0, :2]
    assert np.abs(found - places).max() < 0.3

"""Corners of what moves are tracked to a tenth of a pixel, in bounded memory, repeats left out."""

from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from bodylog.perception.surface import corner_tracks
from bodylog.perception.surface.corner_tracks import (
    CornerTracker,
    moving_pieces,
    places_by_piece,
    track_corners,
)
from bodylog.types import Array, LazyImage


def texture(seed: int, height: int, width: int) -> Array:
    """A smooth random texture (height,width), grey levels."""
    rough = np.random.default_rng(seed).standard_normal((height, width))
    smooth = cv2.GaussianBlur(rough, (0, 0), 2.0)
    return np.asarray(np.clip(128.0 + 110.0 * smooth / np.abs(smooth).max(), 0, 255))


def pictures(count: int, seed: int = 0) -> list[Array]:
    """A textured square of 80 px that moves before a textured wall, (240,320) uint8; 1.5 px a frame, and back."""
    wall, square = texture(seed, 240, 320), texture(seed + 100, 80, 80)
    images = []
    for n in range(count):
        image = wall.copy()
        shift = np.array([[1.0, 0.0, place(n)], [0.0, 1.0, 70.0]])
        cv2.warpAffine(square, shift, (320, 240), image, cv2.INTER_CUBIC, cv2.BORDER_TRANSPARENT)
        images.append(np.clip(image, 0, 255).astype(np.uint8))
    return images


def place(n: int) -> float:
    return 40.0 + 1.5 * abs((n + 80) % 160 - 80)


def film(images: list[Array]) -> Iterator[LazyImage]:
    for n, image in enumerate(images):
        colour = np.dstack([image] * 3)
        yield LazyImage(n / 15.0, n, lambda k, colour=colour: colour[::k, ::k])


def test_corners_inside_the_square_follow_it():
    tracks, survey, _ = track_corners(lambda: film(pictures(80)))
    assert survey.repeats.share is not None and survey.repeats.share < 0.02
    moving = tracks.take(moving_pieces(tracks))
    errors = []
    for k, uv in enumerate(places_by_piece(moving)):
        square = np.array([[place(round(15.0 * t)), 70.0] for t in moving.t[moving.frame[moving.piece == k]]])
        if (np.abs(uv[0] - square[0] - 40.0) < 32.0).all():  # at its rim corners slide along the wall
            errors.append(np.ptp(uv - square, axis=0).max())
    assert len(errors) >= 20
    assert np.percentile(errors, 90) < 0.15


def test_repeats_are_left_out():
    twice = [image for image in pictures(60) for _ in range(2)]
    tracks, survey, _ = track_corners(lambda: film(twice))
    assert survey.repeats.share == pytest.approx(0.5, abs=0.02)
    assert len(tracks.t) == pytest.approx(60, abs=2)


def test_memory_does_not_grow_with_the_film():
    tracker = CornerTracker(None, most_pieces=50)
    images = pictures(40)
    for n in range(160):
        tracker.add(n / 15.0, images[n % 40])
    tracks = tracker.tracks()
    assert tracks.count == 50
    assert tracks.frame.max() > 100


@pytest.mark.parametrize("kept_bytes, looks", [(1 << 27, 1), (100_000, 2)])
def test_film_is_decoded_once_where_its_images_fit_in_memory(monkeypatch, kept_bytes, looks):
    images = pictures(40)
    expected = track_corners(lambda: film(images))[0]
    monkeypatch.setattr(corner_tracks, "_MOST_KEPT_BYTES", kept_bytes)
    reads = []
    found, _, keys = track_corners(lambda: (reads.append(1), film(images))[1], most_key_frames=5)
    assert len(reads) == looks
    np.testing.assert_array_equal(found.uv, expected.uv)
    np.testing.assert_array_equal(keys.t, found.t[[0, 10, 20, 29, 39]])
    assert all(image.shape == (240, 320) for image in keys.images)


def test_same_film_same_tracks():
    first, second = (track_corners(lambda: film(pictures(40)))[0] for _ in range(2))
    np.testing.assert_array_equal(first.uv, second.uv)

"""Points given once: followed on a turning plane, lost behind something and found again, refused where plain."""

from collections.abc import Callable, Iterator

import cv2
import numpy as np
import pytest

from bodylog.errors import EvidenceError, FormatError
from bodylog.perception.points import points
from bodylog.sources import PointSource
from bodylog.types import Array, LazyImage
from tests.perception import tag_scenes
from tests.perception.tag_scenes import Look


def _sheet(seed: int) -> Array:
    """A printed sheet of random dots and bars, (240,240) uint8."""
    rng = np.random.default_rng(seed)
    sheet = np.full((240, 240), 200, np.uint8)
    for _ in range(40):
        (x, y), (w, h) = rng.integers(0, 230, 2), rng.integers(6, 40, 2)
        cv2.rectangle(sheet, (int(x), int(y)), (int(x + w), int(y + h)), int(rng.integers(0, 255)), -1)
    return sheet


def _film(seed: int, count: int, look: Look, hidden: range = range(0)) -> tuple[list[Array], Array]:
    """Frames of a sheet that moves, turns and comes nearer, and where its middle is (N,2) px."""
    rng, wall = np.random.default_rng(seed), tag_scenes.wall(np.random.default_rng(seed), 320, 240).astype(float)
    images, places = [], []
    for k in range(count):
        phase = k / 12
        turn = cv2.Rodrigues(np.array([0.3 * np.sin(phase), 0.4 * np.sin(1.3 * phase), 0.8 * np.sin(0.7 * phase)]))[0]
        middle = (160 + 60 * np.sin(phase), 120 + 30 * np.cos(phase), 600.0)
        camera = np.array([[600.0, 0, middle[0]], [0, 600, middle[1]], [0, 0, 1]])
        at = camera @ np.column_stack([turn[:, 0], turn[:, 1], [0, 0, 600 / (70 + 12 * np.sin(phase / 2))]])
        image = tag_scenes.paste(wall, _sheet(seed), (1, 1), at)
        places.append(tag_scenes.project(at, np.zeros((1, 2)))[0])
        if k in hidden:
            u, v = np.rint(places[-1]).astype(int)
            image[max(0, v - 40) : v + 40, max(0, u - 40) : u + 40] = 120
        images.append(tag_scenes.take(image, look, rng))
    return images, np.array(places)


def _frames(images: list[Array]) -> Callable[[], Iterator[LazyImage]]:
    def colour(image: Array) -> Callable[[int], Array]:
        return lambda k: np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))

    return lambda: (LazyImage(k / 10, k, colour(image)) for k, image in enumerate(images))


@pytest.mark.parametrize("noise", [1.0, 5.0])
def test_point_is_followed_with_its_stated_precision(noise: float) -> None:
    apart, stated = [], []
    for seed in range(3):
        images, places = _film(seed, 26, Look(noise=noise))
        (found,) = points.track_points(_frames(images), {"tip": PointSource(tuple(places[0]), 0.0)})
        seen = np.isfinite(found.values[:, 0, 0])
        assert found.names == ("tip",) and seen.mean() > 0.95
        apart.append((found.values[:, 0, :2] - places)[seen])
        stated.append(found.values[seen, 0, 2:])
    errors, text = np.concatenate(apart), np.concatenate(stated)
    true = np.sqrt(np.mean(errors**2))
    assert np.abs(errors).max() < 0.6 and true < 0.15
    assert 0.5 < np.sqrt(np.mean(text**2)) / true < 2.0
    late = np.concatenate([one[-8:] for one in apart])
    assert np.sqrt(np.mean(late**2)) < 0.15


def test_hidden_point_is_counted_and_found_again() -> None:
    images, places = _film(2, 24, Look(), range(10, 16))
    frames = [*_frames(images)()]
    frames[20] = LazyImage(2.0, 20, _broken)
    (found,) = points.track_points(lambda: iter(frames), {"tip": PointSource(tuple(places[0]), 0.0)})
    seen = np.isfinite(found.values[:, 0, 0])
    assert not seen[10:16].any() and not seen[20] and seen[:10].all() and seen[16:20].any() and seen[22:].all()
    assert np.abs(found.values[seen, 0, :2] - places[seen]).max() < 0.6
    assert found.reasons[12] == "hidden" and found.reasons[20] == "undecodable picture"


def _broken(scale: int) -> Array:
    raise FormatError("an image that ends early")


@pytest.mark.parametrize(
    ("point", "at", "message"),
    [
        ((3.0, 100.0), 0.0, r"features.tip.point is \[3.0, 100.0\]; possible: 6 to 313, 6 to 233 px"),
        ((160.0, 120.0), 9.0, "features.tip.at is 9 s, but no image was taken then: the nearest is at 0.100 s"),
        ((160.0, 120.0), 0.0, "too plain to follow; take a corner"),
    ],
)
def test_tracked_refuses_a_point_it_cannot_follow(point, at, message) -> None:
    with pytest.raises(EvidenceError, match=message):
        points.track_points(_frames([np.full((240, 320), 90, np.uint8)] * 2), {"tip": PointSource(point, at)})

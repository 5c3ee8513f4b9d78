"""Pictures with known answers: coloured discs drawn to a fraction of a pixel on a blotchy wall, with noise, as JPEG."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from bodylog.perception.colours.colour_tracker import colour_tracks, search_colours
from bodylog.types import Array, LazyImage, Recording, Series
from tests.changed_recordings import make_recording

GREEN, RED, YELLOW = (40, 190, 30), (36, 34, 200), (20, 210, 220)
REDUCED = {1: 1, 2: cv2.IMREAD_REDUCED_COLOR_2, 4: cv2.IMREAD_REDUCED_COLOR_4, 8: cv2.IMREAD_REDUCED_COLOR_8}


def track_colours(frames, colours, progress=None, fast=False):
    """The tracks of colours in frames, their health and findings."""
    return colour_tracks(search_colours(frames, colours, progress, fast), frames, colours)


@dataclass(frozen=True)
class Disc:
    """A disc of one colour (BGR), centre and radius in px; `shade` darkens it by that share from left to right."""

    u: float
    v: float
    radius: float
    colour: tuple[int, int, int] = GREEN
    shade: float = 0.0


def wall(rng: np.random.Generator, width: int = 320, height: int = 240, contrast: float = 8.0) -> Array:
    """A grey wall (H,W,3) float with blotches a few px wide."""
    pixel_noise = rng.normal(0.0, 1.0, (height, width, 3))
    soft = cv2.GaussianBlur(pixel_noise, (0, 0), 2.5)
    return np.asarray(110.0 + contrast * soft / soft.std())


def draw(background: Array, discs: Sequence[Disc], rng: np.random.Generator, noise: float = 2.0) -> Array:
    """The picture (H,W,3) uint8 of discs, later ones in front."""
    picture = background.astype(np.float32)
    for disc in discs:
        _paint(picture, disc)
    pixel_noise = rng.standard_normal(picture.shape, dtype=np.float32)
    return np.clip(np.rint(picture + np.float32(noise) * pixel_noise), 0, 255).astype(np.uint8)


def _paint(picture: Array, disc: Disc) -> None:
    reach = int(disc.radius) + 3
    top, left = max(0, int(disc.v) - reach), max(0, int(disc.u) - reach)
    part = picture[top : max(0, int(disc.v) + reach), left : max(0, int(disc.u) + reach)]
    v, u = np.mgrid[top : top + part.shape[0], left : left + part.shape[1]]
    cover = np.clip(disc.radius + 0.5 - np.hypot(u - disc.u, v - disc.v), 0.0, 1.0)[..., None]
    light = 1.0 - disc.shade * (0.5 + 0.5 * (u - disc.u) / disc.radius)[..., None]
    part += (cover * (light * np.array(disc.colour) - part)).astype(np.float32)


def jpeg(picture: Array, quality: int = 90) -> Array:
    """The picture's bytes (n,) uint8 as a JPEG file."""
    return np.asarray(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


def frame(t: float, payload: Array) -> LazyImage:
    """A Frame that decodes a JPEG."""
    return LazyImage(t, round(t * 1e9), lambda k: cv2.imdecode(payload, REDUCED[k]), shrinks=True)


def frames(t: Array, payloads: Sequence[Array]) -> Callable[[], Iterator[LazyImage]]:
    """What a Recording's frames are, of JPEG payloads."""
    return lambda: (frame(float(moment), payload) for moment, payload in zip(t, payloads, strict=True))


def recording(pictures: Callable[[], Iterator[LazyImage]] | None = None, skin: Series | None = None) -> Recording:
    """A Recording of pictures and skin alone."""
    return make_recording("test", skin=skin, frames=pictures)

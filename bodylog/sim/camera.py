"""The head camera: a pinhole, its noise, and spheres drawn with subpixel accuracy.

Pixel (0, 0) is the centre of the upper left pixel. The renderer that draws the arm has no
anti-aliasing, so the tracked end effector and hand are drawn here from their exact outlines; the
arm still hides them by its depth.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..types import Array

NEAR = 0.1
FAR = 4.0
Colour = tuple[float, float, float]
GREEN: Colour = (26.0, 190.0, 40.0)
RED: Colour = (200.0, 32.0, 36.0)
BLUE: Colour = (36.0, 70.0, 210.0)
_NOISE_GREY = 2.0
_CARD = (96, 98, 102)


@dataclass(frozen=True, eq=False)
class PinholeCamera:
    """A pinhole: size (px), focal length (px), position (3,)
    m, rotation (3,3) base -> optical (right, down, ahead).

    first_row: of a picture of which it shows some rows alone,
    whose height is whole_height px; None where it shows all.
    """

    width: int
    height: int
    focal: float
    position: Array
    rotation: Array
    first_row: int = 0
    whole_height: int | None = None

    @property
    def centre(self) -> tuple[float, float]:
        """The principal point (px)."""
        height = self.height if self.whole_height is None else self.whole_height
        return (self.width - 1) / 2, (height - 1) / 2 - self.first_row

    def take_rows(self, first: int, end: int) -> "PinholeCamera":
        """The camera of the rows from `first` to before `end` of this one's pictures."""
        return replace(self, height=end - first, first_row=first, whole_height=self.height)


def look_at(position: Array, target: Array, size: tuple[int, int]) -> PinholeCamera:
    """A camera at `position` that sees `target` in its centre, upright, 58 degrees wide."""
    ahead = (target - position) / np.linalg.norm(target - position)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return PinholeCamera(
        *size, 0.9 * size[0], position, np.array([right, np.cross(ahead, right), ahead])
    )


def wide_camera(size: tuple[int, int]) -> PinholeCamera:
    """A camera at the origin that looks along z, 90 degrees wide, as cameras on wrists are."""
    return PinholeCamera(*size, 0.5 * size[0], np.zeros(3), np.eye(3))


def ellipse_centre(camera: PinholeCamera, centre: Array, radius: float) -> Array:
    """Pixels (N,2) where the outlines of spheres at `centre` (N,3) m have their centroid.

    A sphere at (X, Y, Z) projects to an ellipse centred on (X, Y)·Z/(Z²
    − r²), a little outside the projection of its own centre: this, not
    the latter, is what the centroid of a coloured blob measures.
    """
    x, y, z = ((centre - camera.position) @ camera.rotation.T).T
    scale = camera.focal * z / (z**2 - radius**2)
    return np.column_stack([x * scale, y * scale]) + camera.centre


def draw_background(
    camera: PinholeCamera, rng: np.random.Generator, textured: bool = False
) -> Array:
    """A dark, unsaturated wall (H,W,3) uint8 with soft
    blotches, or with fine grey ones that show if it moves.
    """
    import cv2

    if textured:
        fine = rng.uniform(40.0, 84.0, (36, 48))
        grey = np.clip(
            cv2.resize(fine, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC), 0, 255
        )
        return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)
    coarse = rng.uniform(52.0, 72.0, (9, 12, 1)) + rng.uniform(-1.5, 1.5, (9, 12, 3))
    wall = cv2.resize(coarse, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(np.clip(wall, 0, 255).astype(np.uint8))


def draw_sphere(
    picture: Array, depth: Array, camera: PinholeCamera, centre: Array, radius: float, colour: Array
) -> float:
    """Draw a lit sphere into an image (H,W,3) uint8 and depth
    (H,W) m; return the visible share of its outline, 0..1.

    The arm less than one radius before its surface carries it and does not hide it. Nothing drawn
    later covers it: draw the nearest first.
    """
    place = camera.rotation @ (centre - camera.position)
    if place[2] < NEAR + radius:
        return 0.0
    window, full_area = _window_of_sphere(camera, place, radius)
    rows, columns = window
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return 0.0
    cover, surface, light = _shade_sphere(camera, place, radius, rows, columns)
    cover = np.where(surface < depth[window] + radius, cover, 0.0)
    old = picture[window].astype(float)
    new = old + cover[..., None] * (light[..., None] * colour - old)
    picture[window] = np.rint(new).astype(np.uint8)
    depth[window] = np.where(cover > 0.5, 0.0, depth[window])
    return float(cover.sum() / full_area)


def _window_of_sphere(
    camera: PinholeCamera, place: Array, radius: float
) -> tuple[tuple[slice, slice], float]:
    """The rows and columns that the outline touches, and its whole area in px²."""
    x, y, z = place
    flat = z**2 - radius**2
    middle = np.array([x, y]) * z / flat
    # Half axes of the outline along u and v: from the tangents of the cone.
    half = radius * np.sqrt(np.array([x**2, y**2]) + flat) / flat
    low = np.floor(camera.focal * (middle - half) + camera.centre).astype(int) - 1
    high = np.ceil(camera.focal * (middle + half) + camera.centre).astype(int) + 2
    low = np.maximum(low, 0)
    high = np.minimum(high, [camera.width, camera.height])
    area = np.pi * radius**2 * np.sqrt(x**2 + y**2 + flat) / flat**1.5 * camera.focal**2
    return (slice(low[1], high[1]), slice(low[0], high[0])), float(area)


def _shade_sphere(
    camera: PinholeCamera, place: Array, radius: float, rows: slice, columns: slice
) -> tuple[Array, Array, Array]:
    """Per pixel: covered share, depth of the surface (m), brightness."""
    u, v = np.meshgrid(np.arange(columns.start, columns.stop), np.arange(rows.start, rows.stop))
    ray = np.stack(
        [
            (u - camera.centre[0]) / camera.focal,
            (v - camera.centre[1]) / camera.focal,
            np.ones(u.shape),
        ],
        -1,
    )
    along = ray @ place
    square = (ray**2).sum(-1)
    reach = float(place @ place) - radius**2
    # Inside the outline the discriminant is positive; divided
    # by its gradient it is the distance to the edge in px.
    inside = along**2 - reach * square
    gradient = 2.0 * (along[..., None] * place[:2] - reach * ray[..., :2]) / camera.focal
    cover = np.clip(0.5 + inside / np.maximum(np.linalg.norm(gradient, axis=-1), 1e-12), 0.0, 1.0)
    distance = (along - np.sqrt(np.maximum(inside, 0.0))) / square
    # The lamp is at the camera: light from the side would
    # shift the bright part's centroid from the outline's.
    facing = (along - distance * square) / (radius * np.sqrt(square))
    return cover, distance, 0.8 + 0.2 * facing


def draw_card(
    picture: Array, depth: Array, box: tuple[int, int, int, int], distance: float
) -> None:
    """Draw a grey card over columns and rows (left, top,
    right, bottom) that hides all beyond `distance` m.
    """
    left, top, right, bottom = box
    picture[top:bottom, left:right] = _CARD
    depth[top:bottom, left:right] = distance


def sensor_noise(camera: PinholeCamera, rng: np.random.Generator) -> Array:
    """Camera noise to crop from: larger than an image,
    so that every crop differs; int8, 2 grey levels.
    """
    noise = rng.standard_normal((camera.height + 64, camera.width + 64, 3), dtype=np.float32)
    return np.asarray(np.rint(noise * _NOISE_GREY).astype(np.int8))


def expose_image(picture: Array, noise: Array, rng: np.random.Generator) -> Array:
    """The image (H,W,3) uint8 with a random crop of `noise` added."""
    import cv2

    top, left = rng.integers(0, 65, 2)
    height, width = picture.shape[:2]
    crop = noise[top : top + height, left : left + width]
    return np.asarray(cv2.add(picture, crop, dtype=cv2.CV_8U))

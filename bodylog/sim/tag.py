"""AprilTags on square plates, drawn with subpixel accuracy; the arm and nearer things hide them."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ..types import Array
from .camera import NEAR, PinholeCamera

CELLS = 10
"""Cells along a plate of family 36h11: six of code, two of black border, two of white margin."""

_BLACK = 18.0
_WHITE = 225.0
_TEXELS = 16
_FINER = 4


@dataclass(frozen=True, eq=False)
class Plate:
    """AprilTag 36h11 `number`: centre (3,) m, rotation (3,3)
    whose columns point right, down and away from the viewer.

    `side` is that of the black square in m, as for tag detectors.
    """

    place: Array
    rotation: Array
    side: float
    number: int

    def moved(self, place: Array, rotation: Array) -> "Plate":
        """The same plate, given in a frame at `place` (3,) m turned by `rotation` (3,3)."""
        return replace(self, place=rotation @ self.place + place, rotation=rotation @ self.rotation)

    def pixel(self, camera: PinholeCamera) -> Array:
        """The centre's image (2,) px."""
        return np.asarray(_project_to_pixels(camera, self.place[None])[0])

    def corners(self, side: float) -> Array:
        """Corners (4,3) m of a concentric square: upper left and right, lower right and left."""
        square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * side / 2
        return np.asarray(self.place + square @ self.rotation[:, :2].T)

    def draw(self, picture: Array, depth: Array, camera: PinholeCamera) -> float:
        """Draw the plate into an image (H,W,3) uint8 and
        depth (H,W) m; return its visible share, 0..1.
        """
        import cv2

        plate = self.corners(self.side * CELLS / (CELLS - 2))
        ahead = (plate - camera.position) @ camera.rotation[2]
        towards = self.place - camera.position
        facing = float(self.rotation[:, 2] @ towards / np.linalg.norm(towards))
        if ahead.min() < NEAR or facing <= 0.1:
            return 0.0
        outline = _project_to_pixels(camera, plate)
        low = np.maximum(np.floor(outline.min(0)).astype(int) - 1, 0)
        high = np.minimum(np.ceil(outline.max(0)).astype(int) + 2, [camera.width, camera.height])
        if (low >= high).any():
            return 0.0
        texture, cover = _draw_window(self.number, outline, low, high)
        window = slice(low[1], high[1]), slice(low[0], high[0])
        near = _distance_to_plate(camera, self, window) < depth[window] + self.side / 4
        cover = np.where(near, cover, 0.0)
        light = 0.7 + 0.3 * facing
        old = picture[window].astype(float)
        picture[window] = np.rint(
            old + cover[..., None] * (light * texture[..., None] - old)
        ).astype(np.uint8)
        depth[window] = np.where(cover > 0.5, 0.0, depth[window])
        return float(cover.sum() / cv2.contourArea(outline.astype(np.float32)))


def _project_to_pixels(camera: PinholeCamera, places: Array) -> Array:
    """Pixels (N,2) of points (N,3) m in the base frame."""
    x, y, z = ((places - camera.position) @ camera.rotation.T).T
    return np.column_stack([x / z, y / z]) * camera.focal + camera.centre


@cache
def tag_texture(number: int) -> Array:
    """The plate (160,160) float32 in grey levels."""
    import cv2

    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    square = cv2.aruco.generateImageMarker(family, number, (CELLS - 2) * _TEXELS)
    plate = np.pad(square, _TEXELS, constant_values=255)
    return np.asarray(np.where(plate > 127, _WHITE, _BLACK).astype(np.float32))


def _draw_window(number: int, outline: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Grey levels and covered share of the pixels of a
    window: drawn at a higher resolution, then averaged.
    """
    import cv2

    plate = tag_texture(number)
    edge = plate.shape[0] - 0.5
    # Outer edges of the texture's corner texels, and of the finer pixels of the window.
    corners = np.array([[-0.5, -0.5], [edge, -0.5], [edge, edge], [-0.5, edge]], np.float32)
    finer = ((outline - low + 0.5) * _FINER - 0.5).astype(np.float32)
    transform = cv2.getPerspectiveTransform(corners, finer)
    width, height = (int(length) for length in high - low)
    fine = (width * _FINER, height * _FINER)
    grey = cv2.warpPerspective(
        plate, transform, fine, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    inside = cv2.warpPerspective(np.ones_like(plate), transform, fine, flags=cv2.INTER_LINEAR)
    cover = cv2.resize(inside, (width, height), interpolation=cv2.INTER_AREA)
    weighted = cv2.resize(grey * inside, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(weighted / np.maximum(cover, 1e-6)), np.asarray(cover)


def _distance_to_plate(camera: PinholeCamera, plate: Plate, window: tuple[slice, slice]) -> Array:
    """Depth along the view (m) of the plate's plane at each pixel of a window."""
    rows, columns = window
    u, v = np.meshgrid(np.arange(columns.start, columns.stop), np.arange(rows.start, rows.stop))
    ray = np.stack(
        [
            (u - camera.centre[0]) / camera.focal,
            (v - camera.centre[1]) / camera.focal,
            np.ones(u.shape),
        ],
        -1,
    )
    normal = camera.rotation @ plate.rotation[:, 2]
    across = ray @ normal
    reach = float(normal @ (camera.rotation @ (plate.place - camera.position)))
    return np.asarray(reach / np.where(across > 1e-6, across, 1e-6))

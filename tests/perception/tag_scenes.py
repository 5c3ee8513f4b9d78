"""Tags and boards drawn with known corners: perspective, light from one side, blur, noise and JPEG."""

from dataclasses import dataclass

import cv2
import numpy as np

from bodylog.types import Array

_FINE = 5


@dataclass(frozen=True)
class Look:
    """How an image is taken: blur px, noise in gray levels, what light adds from left to right, JPEG quality."""

    blur: float = 0.7
    noise: float = 2.0
    slope: float = 40.0
    quality: int = 85


def dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))


def tag(name: str, number: int, margin: int = 1) -> Array:
    """A printed tag, 20 px a cell, with `margin` white cells about it."""
    known = dictionary(name)
    side = 20 * (known.markerSize + 2)
    return np.pad(cv2.aruco.generateImageMarker(known, number, side), 20 * margin, constant_values=255)


def wall(rng: np.random.Generator, width: int, height: int) -> Array:
    """A background of blotches and lines, (H,W) uint8."""
    blotches = cv2.resize(rng.uniform(60, 190, (height // 24, width // 24)).astype(np.float32), (width, height))
    image = blotches.astype(np.uint8)
    for _ in range(12):
        (u, v), (du, dv) = rng.integers(0, (width, height)), rng.integers(10, 60, 2)
        cv2.rectangle(image, (int(u), int(v)), (int(u + du), int(v + dv)), int(rng.integers(20, 235)), -1)
    return image


def pose(rng: np.random.Generator, centre: tuple[float, float], side: float, tilt: float = 0.7) -> Array:
    """H (3,3) from the plane (x, y in sides, origin in the middle) to px: turned, tilted by up to `tilt` rad."""
    turn, lean, way = rng.uniform(-np.pi, np.pi), rng.uniform(0, tilt), rng.uniform(-np.pi, np.pi)
    leant = cv2.Rodrigues(np.array([np.cos(way), np.sin(way), 0]) * lean)[0]
    rotation = leant @ cv2.Rodrigues(np.array([0.0, 0.0, turn]))[0]
    focal = 600.0
    return np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]]) @ np.column_stack(
        [rotation[:, 0], rotation[:, 1], [0, 0, focal / side]]
    )


def project(pose: Array, points: Array) -> Array:
    """Points (N,2) of the plane in px (N,2)."""
    whole = np.column_stack([points, np.ones(len(points))]) @ pose.T
    return whole[:, :2] / whole[:, 2:]


def paste(image: Array, print_: Array, sides: tuple[float, float], pose: Array) -> Array:
    """The image (H,W) float with a printed sheet, of so many sides' width and height about the origin, in it."""
    height, width = image.shape
    rows, columns = print_.shape
    to_plane = np.array([[sides[0] / columns, 0, -sides[0] / 2], [0, sides[1] / rows, -sides[1] / 2], [0, 0, 1]])
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # pixel centres of the sheet lie at halves
    fine = np.array([[_FINE, 0, (_FINE - 1) / 2], [0, _FINE, (_FINE - 1) / 2], [0, 0, 1]])
    whole = fine @ pose @ to_plane @ half
    size = (width * _FINE, height * _FINE)
    ink = cv2.warpPerspective(print_.astype(np.float32), whole, size, flags=cv2.INTER_LINEAR)
    mask = cv2.warpPerspective(np.ones_like(print_, np.float32), whole, size, flags=cv2.INTER_LINEAR)
    mask, ink = (cv2.resize(one, (width, height), interpolation=cv2.INTER_AREA) for one in (mask, ink * mask))
    return np.asarray(image * (1 - mask) + (40 + 0.75 * ink) * mask)


def take(image: Array, look: Look, rng: np.random.Generator) -> Array:
    """The image as a camera gives it, (H,W) uint8."""
    light = image * (1 + look.slope / 255 * np.linspace(-0.5, 0.5, image.shape[1]))
    blurred = cv2.GaussianBlur(light, (0, 0), look.blur) if look.blur else light
    noisy = np.clip(blurred + rng.normal(0, look.noise, image.shape), 0, 255).astype(np.uint8)
    if not look.quality:
        return noisy
    jpeg = cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, look.quality])[1]
    return np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_GRAYSCALE))


CORNERS = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
"""Of a tag, in sides, as printed from top left clockwise."""


def scene(
    rng: np.random.Generator, name: str, number: int, side: float, look: Look, size: tuple[int, int] = (200, 160)
) -> tuple[Array, Array, Array]:
    """An image with one tag, its corners (4,2) px and centre (2,) px."""
    middle = np.array(size) / 2 + rng.uniform(-10, 10, 2)
    at = pose(rng, (middle[0], middle[1]), side)
    cells = dictionary(name).markerSize + 2
    sheet = paste(wall(rng, *size).astype(float), tag(name, number), ((cells + 2) / cells,) * 2, at)
    return take(sheet, look, rng), project(at, CORNERS), project(at, np.zeros((1, 2)))[0]


def board_scene(
    rng: np.random.Generator,
    shape: tuple[int, int],
    square: float,
    look: Look,
    legacy: bool = False,
    size: tuple[int, int] = (480, 360),
) -> tuple[Array, Array]:
    """An image with a ChArUco board (4x4_1000, markers 4/7 of a square) and its inner corners (K,2) px."""
    board = cv2.aruco.CharucoBoard(shape, 0.07, 0.04, dictionary("4X4_1000"))
    board.setLegacyPattern(legacy)
    sheet = np.pad(board.generateImage((shape[0] * 56, shape[1] * 56)), 28, constant_values=255)
    at = pose(rng, (size[0] / 2 + rng.uniform(-9, 9), size[1] / 2 + rng.uniform(-9, 9)), square, 0.5)
    image = paste(wall(rng, *size).astype(float), sheet, (shape[0] + 1, shape[1] + 1), at)
    plane = np.asarray(board.getChessboardCorners())[:, :2] / 0.07 - np.array(shape) / 2
    return take(image, look, rng), project(at, plane)

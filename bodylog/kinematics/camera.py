"""A pinhole camera with two radial distortion terms, and a tracker of
points in space, both vectorised over points.
"""

import numpy as np

from ..types import MM_PER_M, Array

NEAREST = 0.02
"""m: lower bound on depth, so that a search can pass a point behind the camera."""


def lens_without_distortion(focal: float, width: float, height: float) -> Array:
    """Parameters (6,) of a lens without distortion:
    ln f (px), ln of fv over fu, centre (px), k1, k2.
    """
    return np.array([np.log(focal), 0.0, width / 2.0, height / 2.0, 0.0, 0.0])


def project_points(points: Array, numbers: Array) -> tuple[Array, Array, Array]:
    """Project points (…,3) m: image (…,2) px ·
    derivative by point (…,2,3) · by the lens (…,2,6).
    """
    image, by_point = project_with_slopes(points, numbers)
    plain = points[..., :2] / np.maximum(points[..., 2:], NEAREST)
    focal = np.exp(numbers[0]) * np.array([1.0, np.exp(numbers[1])])
    square = np.square(plain).sum(axis=-1)
    bend = 1.0 + square * (numbers[4] + numbers[5] * square)
    return image, by_point, _by_lens(plain, square, bend, focal)


def project_with_slopes(points: Array, numbers: Array) -> tuple[Array, Array]:
    """Project points (…,3) m: image (…,2) px · derivative by point (…,2,3)."""
    depth = np.maximum(points[..., 2], NEAREST)
    x = points[..., 0] / depth
    y = points[..., 1] / depth
    focal = np.exp(numbers[0]) * np.array([1.0, np.exp(numbers[1])])
    square = x * x + y * y
    bend = 1.0 + square * (numbers[4] + numbers[5] * square)
    rise = 2.0 * (numbers[4] + 2.0 * numbers[5] * square)
    image = np.empty((*x.shape, 2))
    image[..., 0] = focal[0] * x * bend + numbers[2]
    image[..., 1] = focal[1] * y * bend + numbers[3]
    # d(x bend, y bend) / d(x, y) = bend I + rise [x y]ᵀ[x y]
    by_point = np.empty((*x.shape, 2, 3))
    by_point[..., 0, 0] = bend + rise * x * x
    by_point[..., 0, 1] = rise * x * y
    by_point[..., 1, 0] = by_point[..., 0, 1]
    by_point[..., 1, 1] = bend + rise * y * y
    along = (bend + rise * square) * (points[..., 2] > NEAREST)
    by_point[..., 0, 2] = -along * x
    by_point[..., 1, 2] = -along * y
    by_point *= focal[:, None] / depth[..., None, None]
    return image, by_point


def scale_points(points: Array) -> tuple[Array, Array, Array]:
    """Points (…,3) m in mm, as a tracker measures them: points (…,3) ·
    derivative by point (…,3,3) · by a lens that is not there (…,3,0).
    """
    by_point = np.broadcast_to(MM_PER_M * np.eye(3), (*points.shape, 3))
    return MM_PER_M * points, by_point, np.zeros((*points.shape, 0))


def _by_lens(plain: Array, square: Array, bend: Array, focal: Array) -> Array:
    result = np.zeros((*plain.shape[:-1], 2, 6))
    result[..., 0] = focal * plain * bend[..., None]
    result[..., 1, 1] = result[..., 1, 0]
    result[..., 0, 2] = 1.0
    result[..., 1, 3] = 1.0
    result[..., 4] = focal * plain * square[..., None]
    result[..., 5] = result[..., 4] * square[..., None]
    return result

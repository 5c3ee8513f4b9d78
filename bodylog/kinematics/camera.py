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
    depth = np.maximum(points[..., 2], NEAREST)
    x, y = points[..., 0] / depth, points[..., 1] / depth
    fu = np.exp(numbers[0])
    focal = np.array([fu, fu * np.exp(numbers[1])])
    square = x * x + y * y
    bend = 1.0 + square * (numbers[4] + numbers[5] * square)
    rise = 2.0 * (numbers[4] + 2.0 * numbers[5] * square)
    plain = np.stack([x, y], axis=-1)
    image = focal * plain * bend[..., None] + numbers[2:4]
    # d(x bend, y bend) / d(x, y): bend I + rise [x y]ᵀ[x y]
    inner = (
        bend[..., None, None] * np.eye(2)
        + rise[..., None, None] * plain[..., :, None] * plain[..., None, :]
    )
    shrink = np.zeros((*points.shape[:-1], 2, 3))
    shrink[..., 0, 0] = shrink[..., 1, 1] = 1.0 / depth
    shrink[..., 2] = -plain / depth[..., None] * (points[..., 2] > NEAREST)[..., None]
    return image, focal[:, None] * (inner @ shrink), _by_lens(plain, square, bend, focal)


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
    result[..., 0, 2] = result[..., 1, 3] = 1.0
    result[..., 4] = focal * plain * square[..., None]
    result[..., 5] = result[..., 4] * square[..., None]
    return result

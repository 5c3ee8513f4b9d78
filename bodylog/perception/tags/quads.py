"""Dark quadrilaterals in gray images, and the cells within them."""

import numpy as np

from ...types import Array

_WINDOW = 15
_DARKER = 7
"""Adaptive threshold: width of the neighbourhood, px, and
how many gray levels darker than its mean (OpenCV's C).
"""
_ROWS = 1 << 14
_STRAIGHT = 0.05
"""Largest distance of a contour from its quad, as a share of its perimeter."""


def find_quads(gray: Array, shortest: float) -> Array:
    """Corners (M,4,2) px, clockwise, of dark convex quads
    in (H,W) uint8 whose sides have `shortest` px at least.
    """
    import cv2

    if min(gray.shape) < 2 * _DARKER:
        return np.empty((0, 4, 2))
    dark = cv2.adaptiveThreshold(
        gray, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, _WINDOW, _DARKER
    )
    found = []
    for outline in cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]:
        if len(outline) < 3 * shortest:
            continue
        quad = cv2.approxPolyDP(outline, _STRAIGHT * len(outline), True)
        if len(quad) == 4 and cv2.isContourConvex(quad):
            found.append(quad[:, 0])
    quads = np.array(found, float).reshape(-1, 4, 2)
    sides = np.linalg.norm(quads - np.roll(quads, -1, axis=1), axis=2).min(axis=1)
    quads = quads[sides >= shortest]
    quads[_signed_area(quads) < 0] = quads[_signed_area(quads) < 0][:, ::-1]
    return np.asarray(quads)


def _signed_area(quads: Array) -> Array:
    """Signed areas (M,), positive where clockwise as seen (v is down)."""
    u = quads[..., 0]
    v = quads[..., 1]
    return np.asarray((u * np.roll(v, -1, axis=1) - v * np.roll(u, -1, axis=1)).sum(axis=1) / 2)


def homographies_of_quads(quads: Array) -> Array:
    """H (M,3,3) from the unit square (0,0), (1,0), (1,1),
    (0,1) to quads (M,4,2) (Heckbert 1989, eq. 2.13).
    """
    (u0, v0), (u1, v1), (u2, v2), (u3, v3) = np.moveaxis(quads, 0, 2)
    du = u0 - u1 + u2 - u3
    dv = v0 - v1 + v2 - v3
    bottom = (u1 - u2) * (v3 - v2) - (u3 - u2) * (v1 - v2)
    bottom = np.where(np.abs(bottom) < 1e-9, 1e-9, bottom)
    g = (du * (v3 - v2) - (u3 - u2) * dv) / bottom
    h = ((u1 - u2) * dv - du * (v1 - v2)) / bottom
    rows = [
        u1 - u0 + g * u1,
        u3 - u0 + h * u3,
        u0,
        v1 - v0 + g * v1,
        v3 - v0 + h * v3,
        v0,
        g,
        h,
        np.ones_like(g),
    ]
    return np.stack(rows, axis=1).reshape(-1, 3, 3)


def apply_homographies(maps: Array, points: Array) -> Array:
    """Where H (M,3,3) takes points (P,2): (M,P,2)."""
    whole = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ np.swapaxes(maps, 1, 2)
    below = np.where(np.abs(whole[..., 2:]) < 1e-9, 1e-9, whole[..., 2:])
    return np.asarray(whole[..., :2] / below)


def sample_gray(gray: Array, points: Array) -> Array:
    """Gray levels (...) at points (...,2) px, bilinear; NaN outside the image."""
    import cv2

    if not points.size:
        return np.empty(points.shape[:-1])
    flat = points.reshape(-1, points.shape[-2], 2).astype(np.float32)
    u = flat[..., 0]
    v = flat[..., 1]
    # OpenCV takes no more rows at once
    parts = [slice(start, start + _ROWS) for start in range(0, len(flat), _ROWS)]
    levels = [
        cv2.remap(gray, u[p], v[p], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for p in parts
    ]
    height, width = gray.shape
    inside = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
    return np.asarray(np.where(inside, np.concatenate(levels), np.nan).reshape(points.shape[:-1]))


def sample_cells(gray: Array, quads: Array, side: int, fine: bool = True) -> tuple[Array, Array]:
    """Gray levels of the bits (M,side²) and of the black
    border's cells (M,4 side + 4) of tags at quads (M,4,2).

    Each is sampled at the cell's middle, or where `fine` the
    mean of four places around it; NaN outside the image.
    """
    whole = side + 2
    middles = (np.arange(whole) + 0.5) / whole
    grid = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
    about = np.array([(-1, -1), (1, -1), (-1, 1), (1, 1)] if fine else [(0, 0)]) * 0.2 / whole
    points = apply_homographies(
        homographies_of_quads(quads), (grid[:, None] + about).reshape(-1, 2)
    )
    levels = sample_gray(gray, points).reshape(len(quads), whole, whole, len(about)).mean(axis=3)
    inner = np.zeros((whole, whole), bool)
    inner[1:-1, 1:-1] = True
    return levels[:, inner], levels[:, ~inner]


def centres_of_quads(quads: Array) -> Array:
    """The crossing of the diagonals of quads (M,4,2): the projection of a square's centre (M,2)."""
    start = quads[:, 0]
    first = quads[:, 2] - quads[:, 0]
    second = quads[:, 3] - quads[:, 1]
    across = quads[:, 1] - start
    bottom = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    share = (across[:, 0] * second[:, 1] - across[:, 1] * second[:, 0]) / np.where(
        np.abs(bottom) < 1e-9, 1e-9, bottom
    )
    return np.asarray(start + share[:, None] * first)

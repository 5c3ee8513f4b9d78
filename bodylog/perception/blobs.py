"""Coloured blobs of one picture: a coarse search of every few pixels, then a full-resolution window per blob.

The centre is that of the blob's mixing weight: how far each pixel lies from the surround's colour towards the
blob's own, which an anti-aliased or blurred edge crosses linearly and a mask does not.
"""

from collections.abc import Sequence

import numpy as np

from ..types import Array
from .ranges import Range, mask

CANDIDATES = 4
U, V, STD_U, STD_V, MASS, BORDER = range(6)
FIELDS = 6
_COARSE_WIDTH = 160
_SMALLEST = 9.0
_SOFT, _ROOM = 3, 12
_DEADBAND, _FULL = 0.15, 0.97
_FLAT = 12
_CORRELATED = 9.0
_QUIETEST = 0.01
_CALIBRATED = 1.25
_SQUARE = np.ones((3, 3), dtype=np.uint8)


def look(image: Array, ranges: Sequence[Range]) -> Array:
    """Blobs of each colour in image (H,W,3) BGR, largest first: (colours, CANDIDATES, FIELDS) px, NaN where none.

    MASS is the blob's area in px², BORDER 1 where the blob, or a small blob's surround, leaves the picture.
    """
    import cv2

    step = max(1, round(image.shape[1] / _COARSE_WIDTH))
    coarse = cv2.cvtColor(np.ascontiguousarray(image[::step, ::step]), cv2.COLOR_BGR2HSV)
    found = np.full((len(ranges), CANDIDATES, FIELDS), np.nan)
    for index, colour in enumerate(ranges):
        measured = [_measure(image, box, colour) for box in _boxes(mask(coarse, colour), step)]
        for rank, row in enumerate(_distinct([row for row in measured if row is not None])):
            found[index, rank] = row
    return found


def _boxes(seen: Array, step: int) -> list[tuple[int, int, int, int]]:
    """x0, y0, x1, y1 (full-resolution px) of the largest components of a coarse mask."""
    import cv2

    if not cv2.countNonZero(seen):
        return []
    stats = cv2.connectedComponentsWithStats(seen, ltype=cv2.CV_16U)[2][1:]
    largest = np.argsort(-stats[:, cv2.CC_STAT_AREA], kind="stable")[:CANDIDATES]
    return [
        ((x - 1) * step, (y - 1) * step, (x + w) * step, (y + h) * step)
        for x, y, w, h, _ in stats[largest].tolist()
    ]


def _measure(image: Array, box: tuple[int, int, int, int], colour: Range) -> tuple[float, ...] | None:
    """The FIELDS of the blob in box, or None where full resolution finds too little of the colour."""
    import cv2

    x0, y0, x1, y1 = box
    margin = 8 + max(x1 - x0, y1 - y0) // 4
    left, top = max(0, x0 - margin), max(0, y0 - margin)
    window = image[top : y1 + margin, left : x1 + margin]
    core = _largest(mask(cv2.cvtColor(window, cv2.COLOR_BGR2HSV), colour))
    if cv2.countNonZero(core) < _SMALLEST:
        return None
    u, v, std_u, std_v, mass = _centre(window, core)
    u, v = left + u, top + v
    inside = min(u, v, image.shape[1] - 1 - u, image.shape[0] - 1 - v)
    return u, v, std_u, std_v, mass, float(inside < max(np.sqrt(mass / np.pi) + _SOFT, _ROOM))


def _largest(seen: Array) -> Array:
    """1 on the largest component of a mask, else 0."""
    import cv2

    count, labels, stats, _ = cv2.connectedComponentsWithStats(seen, ltype=cv2.CV_16U)
    if count < 3:
        return np.minimum(seen, 1)
    return np.equal(labels, 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))).astype(np.uint8)


def _centre(window: Array, core: Array) -> tuple[float, float, float, float, float]:
    """u, v, std_u, std_v (px, in the window) and area of the blob whose sure part is core (H,W) 0 or 1."""
    import cv2

    inner = cv2.erode(core, _SQUARE, iterations=2)
    inner = inner if cv2.countNonZero(inner) >= _FLAT else core
    grown = cv2.dilate(core, _SQUARE, iterations=_SOFT)
    outer = 1 - cv2.dilate(grown, _SQUARE, iterations=2)
    mixing = _mixing(window, inner, outer)
    weight = _weight(mixing / _level(mixing, inner), grown)
    u, v, mass = _centroid(weight)
    flat_u, flat_v, _ = _centroid(_weight(mixing, grown))
    edge = ((weight > 0) & (weight < 1) & (inner == 0)).astype(np.float32)
    around = _noise(mixing, outer, float(edge.sum()) / (2 * np.sqrt(np.pi * mass)))
    columns, rows = np.arange(edge.shape[1]) - u, np.arange(edge.shape[0]) - v
    std_u = around * np.sqrt(float(edge.sum(0) @ columns**2)) / mass
    std_v = around * np.sqrt(float(edge.sum(1) @ rows**2)) / mass
    # shading is not a plane: a seventh of what the plane corrects stays in doubt
    std_u = float(np.sqrt(_QUIETEST**2 + std_u**2 + ((u - flat_u) / 7) ** 2))
    std_v = float(np.sqrt(_QUIETEST**2 + std_v**2 + ((v - flat_v) / 7) ** 2))
    return u, v, std_u, std_v, mass


def _mixing(window: Array, inner: Array, outer: Array) -> Array:
    """0 at the surround's mean colour, 1 at the blob's, in between and beyond along the line of both: (H,W)."""
    import cv2

    blob = np.array(cv2.mean(window, inner)[:3], dtype=np.float32)
    ground = np.array(cv2.mean(window, outer)[:3], dtype=np.float32)
    axis = (blob - ground) / max(float((blob - ground) @ (blob - ground)), 1.0)
    return np.asarray(window @ axis - ground @ axis)


def _level(mixing: Array, inner: Array) -> Array:
    """The mixing a fully covered pixel has, (H,W): a plane through the blob where light grades it, beyond chance."""
    x, y = np.arange(mixing.shape[1], dtype=np.float32), np.arange(mixing.shape[0], dtype=np.float32)
    count = float(inner.sum())
    x = x - float(inner.sum(0) @ x) / count
    y = y - float(inner.sum(1) @ y) / count
    inside = mixing * inner
    mean = float(inside.sum()) / count
    inside = inside - mean * inner
    xx, yy, xy = float(inner.sum(0) @ x**2), float(inner.sum(1) @ y**2), float(y @ inner @ x)
    xz, yz = float(inside.sum(0) @ x), float(inside.sum(1) @ y)
    determinant = max(xx * yy - xy * xy, 1e-9)
    slope_x, slope_y = (yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant
    explained = slope_x * xz + slope_y * yz
    rest = float((inside**2).sum()) - explained
    freedom = max(count / _CORRELATED - 3, 1e-3)
    shrink = max(0.0, 1 - 6 * rest / max(freedom * explained, 1e-12))
    return np.asarray(np.clip(mean + shrink * (slope_x * x + slope_y * y[:, None]), 0.4, 2.0))


def _weight(mixing: Array, grown: Array) -> Array:
    """Covered share of each pixel, with what is little set to none: (H,W) 0..1."""
    return np.clip((mixing - _DEADBAND) / (_FULL - _DEADBAND), 0, 1) * grown


def _centroid(weight: Array) -> tuple[float, float, float]:
    mass = float(weight.sum())
    u = float(weight.sum(0) @ np.arange(weight.shape[1])) / mass
    return u, float(weight.sum(1) @ np.arange(weight.shape[0])) / mass, mass


def _noise(mixing: Array, outer: Array, band: float) -> float:
    """Standard deviation of the weight summed along a blob's edge `band` px wide, per square root of px.

    Neighbouring pixels err together over about 4 px along the edge, and over as many across as the edge is wide;
    the median deviation keeps out of it what else stands in the surround.
    """
    import cv2

    where = outer[::2, ::2] > 0
    if np.count_nonzero(where) < _FLAT:
        return 1.0
    single = _deviation(mixing[::2, ::2][where])
    square = 4.0 * _deviation(cv2.boxFilter(mixing, -1, (4, 4))[::2, ::2][where])
    across = min(max((band - 1) / 3, 0.0), 1.0)
    return float(_CALIBRATED * square ** (0.5 + 0.5 * across) * single ** (0.5 - 0.5 * across) / (_FULL - _DEADBAND))


def _deviation(values: Array) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def _distinct(rows: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """Largest first, each blob once: two coarse pieces of one blob measure the same centre."""
    kept: list[tuple[float, ...]] = []
    for row in sorted(rows, key=lambda row: -row[MASS]):
        if all(abs(row[U] - other[U]) + abs(row[V] - other[V]) > 2 for other in kept):
            kept.append(row)
    return kept

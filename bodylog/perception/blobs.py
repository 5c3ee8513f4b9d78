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
_SURROUND = 6.5
_DEADBAND = 0.15
_QUIETEST = 0.02
_SQUARE = np.ones((3, 3), dtype=np.uint8)


def look(image: Array, ranges: Sequence[Range]) -> Array:
    """Blobs of each colour in image (H,W,3) BGR, largest first: (colours, CANDIDATES, FIELDS) px, NaN where none.

    MASS is the blob's area in px², BORDER 1 where the blob or the surround it is measured against leaves the picture.
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
    room = min(u, v, image.shape[1] - 1 - u, image.shape[0] - 1 - v) - np.sqrt(mass / np.pi)
    return u, v, std_u, std_v, mass, float(room < _SURROUND)


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
    inner = inner if inner.any() else core
    grown = cv2.dilate(core, _SQUARE, iterations=3)
    outer = 1 - cv2.dilate(grown, _SQUARE, iterations=2)
    blob = np.array(cv2.mean(window, inner)[:3], dtype=np.float32)
    ground = np.array(cv2.mean(window, outer)[:3], dtype=np.float32) if outer.any() else np.zeros(3, np.float32)
    axis = (blob - ground) / max(float((blob - ground) @ (blob - ground)), 1.0)
    mixing = window @ axis - ground @ axis
    weight = np.clip((mixing - _DEADBAND) / (1 - _DEADBAND), 0, 1) * grown
    mass = float(weight.sum())
    x = np.arange(weight.shape[1], dtype=np.float32)
    y = np.arange(weight.shape[0], dtype=np.float32)
    u, v = float(weight.sum(0) @ x) / mass, float(weight.sum(1) @ y) / mass
    edge = (weight > 0) & (weight < 1)
    noise = _noise(mixing, outer)
    spread_u = float(edge.sum(0) @ (x - u) ** 2)
    spread_v = float(edge.sum(1) @ (y - v) ** 2)
    std_u, std_v = (float(np.hypot(_QUIETEST, noise * np.sqrt(s) / mass)) for s in (spread_u, spread_v))
    return u, v, std_u, std_v, mass


def _noise(mixing: Array, outer: Array) -> float:
    """Standard deviation of the mixing weight summed over 4 x 4 px, per square root of px: correlation included."""
    import cv2

    box = cv2.boxFilter(mixing, -1, (4, 4))
    return 4.0 * float(cv2.meanStdDev(box, mask=outer)[1][0, 0])


def _distinct(rows: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """Largest first, each blob once: two coarse pieces of one blob measure the same centre."""
    kept: list[tuple[float, ...]] = []
    for row in sorted(rows, key=lambda row: -row[MASS]):
        if all(abs(row[U] - other[U]) + abs(row[V] - other[V]) > 2 for other in kept):
            kept.append(row)
    return kept

"""Coloured blobs of one picture: a coarse search of every few pixels, then a full-resolution window per blob."""

from collections.abc import Sequence

import numpy as np

from ..types import Array
from .centre import measure
from .ranges import Range, mask

CANDIDATES = 4
U, V, STD_U, STD_V, MASS, STRENGTH, BORDER = range(7)
FIELDS = 7
_COARSE_WIDTH = 160
_FAINT = 0.25
_SMALLEST = 9
_MARGIN = 10
_ROOM, _SMALL = 12.0, 8.0
# a straight edge this many radii from a disc's centre cuts a hundredth of its area off
_WHOLE = 0.935

Box = tuple[int, int, int, int]


def look(image: Array, ranges: Sequence[Range]) -> Array:
    """Blobs of each colour in image (H,W,3) BGR, strongest first: (colours, CANDIDATES, FIELDS) px, NaN where none.

    MASS is the blob's area in px², STRENGTH that times its contrast with the surround in grey levels, BORDER 1 where
    the blob, or a small blob's surround, leaves the picture.
    """
    import cv2

    step = max(1, round(image.shape[1] / _COARSE_WIDTH))
    width, height = image.shape[1] // step, image.shape[0] // step
    coarse = cv2.cvtColor(_sampled(image, step, width, height), cv2.COLOR_BGR2HSV)
    found = np.full((len(ranges), CANDIDATES, FIELDS), np.nan)
    for index, colour in enumerate(ranges):
        rows = [row for box in _boxes(mask(coarse, colour), step) if (row := _measured(image, box, colour))]
        for rank, row in enumerate(_distinct(rows)):
            found[index, rank] = row
    return found


def _sampled(image: Array, step: int, width: int, height: int) -> Array:
    """Every step-th pixel of every step-th row: (height,width,4) BGR and a byte of the next pixel, or image itself."""
    if step == 1:
        return image
    whole = np.ascontiguousarray(image)
    # four bytes at a time is a third of the work; the last pixel taken has another after it, as step is above 1
    strides = (step * whole.strides[0], step * whole.strides[1])
    taken = np.ndarray((height, width), np.uint32, whole.data, 0, strides).copy()
    return taken.view(np.uint8).reshape(height, width, 4)


def _boxes(seen: Array, step: int) -> list[Box]:
    """x0, y0, x1, y1 (full-resolution px) about the components of a coarse mask that come near the largest in size."""
    import cv2

    outlines = cv2.findContours(seen, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    if not outlines:
        return []
    largest = sorted(outlines, key=len, reverse=True)[:CANDIDATES]
    boxes = [cv2.boundingRect(outline) for outline in largest if len(outline) >= _FAINT * len(largest[0])]
    return [((x - 1) * step, (y - 1) * step, (x + w) * step, (y + h) * step) for x, y, w, h in boxes]


def _measured(image: Array, box: Box, colour: Range) -> tuple[float, ...] | None:
    """The FIELDS of the blob in box, or None where full resolution finds too little of the colour."""
    import cv2

    x0, y0, x1, y1 = box
    left, top = max(0, x0 - _MARGIN), max(0, y0 - _MARGIN)
    window = np.ascontiguousarray(image[top : y1 + _MARGIN, left : x1 + _MARGIN])
    core = _largest(mask(cv2.cvtColor(window, cv2.COLOR_BGR2HSV), colour))
    if cv2.countNonZero(core) < _SMALLEST:
        return None
    u, v, std_u, std_v, mass, contrast = measure(window, core)
    u, v = left + u, top + v
    radius = (mass / np.pi) ** 0.5
    inside_u, inside_v = min(u, image.shape[1] - 1 - u), min(v, image.shape[0] - 1 - v)
    border = min(inside_u, inside_v) < max(_WHOLE * radius - 0.5, _ROOM if radius < _SMALL else 0.0)
    std_u, std_v = float(np.hypot(std_u, _cut(radius, inside_u))), float(np.hypot(std_v, _cut(radius, inside_v)))
    return u, v, std_u, std_v, mass, mass * contrast, float(border)


def _cut(radius: float, inside: float) -> float:
    """How far (px) the picture's edge, `inside` px away plus half a pixel, pushes a disc's centre that it may cut.

    A disc of radius r has the share (4√2/3π) (h/r)^1.5 in a low segment of height h, at r from its centre.
    """
    return 0.6 * float(max(radius - 0.5 - inside, 0.0) ** 1.5 / radius**0.5)


def _largest(seen: Array) -> Array:
    """1 on the largest component of a mask and on its holes, else 0."""
    import cv2

    outlines = cv2.findContours(seen, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    core = np.zeros_like(seen)
    if outlines:
        cv2.drawContours(core, [max(outlines, key=len)], 0, 1, cv2.FILLED)
    return core


def _distinct(rows: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """Strongest first, each blob once: two coarse pieces of one blob measure the same centre."""
    kept: list[tuple[float, ...]] = []
    for row in sorted(rows, key=lambda row: -row[STRENGTH]):
        if all(abs(row[U] - other[U]) + abs(row[V] - other[V]) > 2 for other in kept):
            kept.append(row)
    return kept

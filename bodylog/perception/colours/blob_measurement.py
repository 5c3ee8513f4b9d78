"""Coloured blobs measured at full resolution: windows of similar size side by side on a sheet."""

from collections.abc import Sequence
from math import isfinite

import numpy as np

from ...types import Array
from .coarse_search import CANDIDATES, FAINT, Window, find_windows
from .hsv_ranges import HsvRange, mask_of_range
from .subpixel_centroid import count_pixels, measure_centroids

U, V, STD_U, STD_V, MASS, STRENGTH, BORDER = range(7)
FIELDS = 7
PLACES = CANDIDATES + FAINT
_SMALLEST = 9
# a straight edge this many radii from a disc's centre removes 1 % of its area
_WHOLE = 0.935
# morphology of a mask reaches 5 px: so many empty ones separate a window from its neighbours
_GUARD = 5
_SIZE_RATIO = 1.3
_PIXELS = 1 << 19


def measured_blobs(images: Sequence[Array], ranges: Sequence[HsvRange]) -> Array:
    """Blobs of each colour in images (H,W,3) BGR:
    (N,colours,PLACES,FIELDS) px, as `blob_tables` gives them.
    """
    return blob_tables(list(find_windows(dict(enumerate(images)), ranges)), len(images), ranges)


def blob_tables(found: Sequence[Window], count: int, ranges: Sequence[HsvRange]) -> Array:
    """Blobs of each colour in the windows of `count` pictures: (count,colours,PLACES,FIELDS) px."""
    by_colour: list[list[Window]] = [[] for _ in ranges]
    for window in found:
        by_colour[window.colour].append(window)
    if not ranges:
        return np.empty((count, 0, CANDIDATES, FIELDS))
    return np.stack(
        [_table_of_colour(some, count, one) for some, one in zip(by_colour, ranges, strict=True)],
        axis=1,
    )


def _table_of_colour(found: Sequence[Window], count: int, colour: HsvRange) -> Array:
    """One colour's blobs in the windows of `count` pictures,
    strongest first: (count,PLACES,FIELDS) px, else NaN.

    MASS is the blob's area in px², STRENGTH that times its contrast with
    the surround in grey levels, BORDER 1 where more than 1 % of the blob
    lies outside the image. Faint ones come after CANDIDATES places.
    """
    blobs = np.full((count, PLACES, FIELDS), np.nan)
    clear = _by_picture([window for window in found if not window.faint], colour)
    faint = _by_picture([window for window in found if window.faint], colour)
    for picture in {*clear, *faint}:
        first = _distinct_blobs(clear.get(picture, []), [])
        blobs[picture, : len(first)] = first or np.empty((0, FIELDS))
        if more := _distinct_blobs(faint.get(picture, []), first):
            blobs[picture, CANDIDATES : CANDIDATES + len(more)] = more
    return blobs


def _by_picture(found: Sequence[Window], colour: HsvRange) -> dict[int, list[list[float]]]:
    """FIELDS of the blob in each window, by picture."""
    rows: dict[int, list[list[float]]] = {}
    for some in _by_size(found):
        for window, row in zip(some, _measure_windows(some, colour).tolist(), strict=True):
            if isfinite(row[U]):
                rows.setdefault(window.picture, []).append(row)
    return rows


def enlarge_blobs(blobs: Array, scale: Array) -> Array:
    """Blobs (N,…,FIELDS) of images shrunk by scale (N,), in pixels of the full images."""
    by = scale.reshape(-1, *[1] * (blobs.ndim - 2)).astype(np.float64)
    whole = blobs.copy()
    # pixel k of a shrunk picture is the mean of those from scale k to scale (k + 1) - 1
    whole[..., U] = by * blobs[..., U] + (by - 1) / 2
    whole[..., V] = by * blobs[..., V] + (by - 1) / 2
    whole[..., STD_U] = by * blobs[..., STD_U]
    whole[..., STD_V] = by * blobs[..., STD_V]
    whole[..., MASS] = by**2 * blobs[..., MASS]
    whole[..., STRENGTH] = by**2 * blobs[..., STRENGTH]
    return whole


def _by_size(found: Sequence[Window]) -> list[list[Window]]:
    """Windows grouped by size, at most one sheet each."""
    sheets: list[list[Window]] = []
    least = 0
    for side, number in sorted(
        (_square_side(window), number) for number, window in enumerate(found)
    ):
        if not sheets or side > _SIZE_RATIO * least or side**2 * (len(sheets[-1]) + 1) > _PIXELS:
            sheets.append([])
            least = side
        sheets[-1].append(found[number])
    return sheets


def _square_side(window: Window) -> int:
    """The side (px) of the square that holds a window and its guard, a multiple of 8."""
    return -(-(int(max(window.pixels.shape[:2])) + _GUARD) // 8) * 8


def _measure_windows(some: Sequence[Window], colour: HsvRange) -> Array:
    """FIELDS of the blob in each window: (K,FIELDS); NaN
    where full resolution finds too little of the colour.
    """
    sheet, valid = _compose_sheet(some)
    core = _largest_component(sheet, valid, colour)
    rows = np.full((len(some), FIELDS), np.nan)
    enough = np.flatnonzero(count_pixels(core) >= _SMALLEST)
    if not enough.size:
        return rows
    if enough.size < len(some):
        sheet = sheet[:, enough]
        core = core[:, enough]
        valid = valid[:, enough]
    u, v, std_u, std_v, mass, contrast = measure_centroids(sheet, core, valid)
    corner = np.array([(some[k].left, some[k].top) for k in enough.tolist()])
    last = np.array([some[k].size for k in enough.tolist()]) - 1
    centre = np.stack([u, v], axis=1) + corner
    std = np.stack([std_u, std_v], axis=1)
    radius = np.sqrt(mass / np.pi)
    inside = np.minimum(centre, last - centre)
    border = inside.min(axis=1) < _WHOLE * radius - 0.5
    std = np.hypot(std, _shift_by_border(radius[:, None], inside))
    rows[enough] = np.column_stack([centre, std, mass, mass * contrast, border])
    return rows


def _compose_sheet(some: Sequence[Window]) -> tuple[Array, Array]:
    """The windows (S,K,S,3), each in the upper left corner
    of its square, and 1 where they are: (S,K,S) uint8.
    """
    side = max(map(_square_side, some))
    sheet = np.zeros((side, len(some), side, 3), np.uint8)
    valid = np.zeros((side, len(some), side), np.uint8)
    for k, window in enumerate(some):
        height, width = window.pixels.shape[:2]
        sheet[:height, k, :width] = window.pixels
        valid[:height, k, :width] = 1
    return sheet, valid


def _shift_by_border(radius: Array, inside: Array) -> Array:
    """The shift (px) of a disc's centre by the image's border, `inside` px away plus half a pixel.

    A disc of radius r has the share (4√2/3π) (h/r)^1.5
    in a low segment of height h, at r from its centre.
    """
    return 0.6 * np.maximum(radius - 0.5 - inside, 0.0) ** 1.5 / np.sqrt(radius)


def _largest_component(sheet: Array, valid: Array, colour: HsvRange) -> Array:
    """1 on the largest component of the colour in each
    square of a sheet, and on its holes: (S,K,S) uint8.
    """
    import cv2

    side = len(sheet)
    seen = mask_of_range(cv2.cvtColor(sheet.reshape(1, -1, 3), cv2.COLOR_BGR2HSV), colour).reshape(
        side, -1
    )
    seen &= valid.reshape(side, -1)
    largest: dict[int, Array] = {}
    for outline in cv2.findContours(seen, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]:
        k = int(outline[0, 0, 0]) // side
        if k not in largest or len(outline) > len(largest[k]):
            largest[k] = outline
    core = np.zeros_like(seen)
    cv2.drawContours(core, list(largest.values()), -1, 1, cv2.FILLED)
    return core.reshape(valid.shape)


def _distinct_blobs(rows: list[list[float]], others: list[list[float]]) -> list[list[float]]:
    """Strongest first, each blob once and none of `others`:
    two coarse pieces of one blob have the same centre.
    """
    kept: list[list[float]] = []
    for row in sorted(rows, key=lambda row: -row[STRENGTH]):
        if all(abs(row[U] - other[U]) + abs(row[V] - other[V]) > 2 for other in (*others, *kept)):
            kept.append(row)
    return kept

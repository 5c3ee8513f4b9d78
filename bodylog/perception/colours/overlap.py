"""A second search where the arm's blob overlaps another
of its colour or is partly hidden: its outline decides.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ...types import Array, LazyImage
from ..tracking.joint_motion import thin_indices
from . import outline
from .blob_measurement import BORDER, FIELDS, MASS, STD_U, STD_V, STRENGTH, U, V
from .clutter import BlobChoice
from .hsv_ranges import HsvRange, mask_of_range

_COMPARED = 60
_FEWEST = 10
_FARTHEST = 0.02
"""Largest error of the predicted place, as a share of the image width."""
_COLOURED = 0.7


def resolve_overlaps(
    found: Array,
    choice: BlobChoice,
    frames: Callable[[], Iterator[LazyImage]],
    colour: HsvRange,
    width: float,
) -> Array:
    """The arm's blob in each image, (N,1,FIELDS) px, NaN for
    none: by its outline where no blob of its own was found.

    `found` (N,candidates,FIELDS) are the candidates.
    """
    rows = np.full((len(found), FIELDS), np.nan)
    there = choice.number >= 0
    rows[there] = found[there, choice.number[there]]
    sure = np.flatnonzero(there & (rows[:, BORDER] == 0))
    asked = np.flatnonzero(
        ~there & (choice.spread < _FARTHEST * width) & np.isfinite(found[:, :, U]).any(axis=1)
    )
    compared = sure[thin_indices(len(sure), _COMPARED)] if asked.size else asked
    parts = _cut_out_parts(frames, {*asked.tolist(), *compared.tolist()}, choice)
    circles = {
        k: _fit_ball_outline(parts[k], choice.radius[k], colour)
        for k in compared.tolist()
        if k in parts
    }
    known = {k: circle for k, circle in circles.items() if circle}
    if len(known) >= _FEWEST:
        # a blob's area ends where its colour does, its outline at half of the light
        excess = float(np.median([circle.excess for circle in known.values()]))
        offset = np.array([(circle.u, circle.v) - rows[k, [U, V]] for k, circle in known.items()])
        strength = float(np.median(rows[sure, STRENGTH]))
        for k in asked.tolist():
            if k in parts and (
                circle := _fit_ball_outline(parts[k], choice.radius[k] + excess, colour)
            ):
                rows[k] = _row_from_outline(circle, offset, float(choice.radius[k]), strength)
    return rows[:, None]


def _row_from_outline(
    circle: outline.Outline, offset: Array, radius: float, strength: float
) -> Array:
    """The fields of a blob whose outline was fitted, as
    if its centre were measured like those of whole blobs.

    `offset` (n,2) px are the outlines' centres minus those of whole blobs.
    """
    middle = np.median(offset, axis=0)
    row = np.zeros(FIELDS)
    row[[U, V]] = np.array([circle.u, circle.v]) - middle
    row[[STD_U, STD_V]] = np.hypot(1.4826 * np.median(np.abs(offset - middle), axis=0), circle.std)
    row[[MASS, STRENGTH, BORDER]] = np.pi * radius**2, strength, 0
    return row


class _BallPart(NamedTuple):
    """Pixels (h,w,3) BGR around the predicted ball: their
    corner (2,), the predicted place (2,) and its spread, px.
    """

    pixels: Array
    corner: Array
    place: Array
    spread: float


def _cut_out_parts(
    frames: Callable[[], Iterator[LazyImage]], wanted: set[int], choice: BlobChoice
) -> dict[int, _BallPart]:
    """The parts of some images around the predicted place, by image number."""
    found: dict[int, _BallPart] = {}
    last = max(wanted, default=-1)
    for number, frame in enumerate(frames()) if wanted else ():
        if number in wanted:
            with suppress(InputError):
                found[number] = _cut_out_part(frame.decode(1), choice, number)
        if number >= last:
            break
    return found


def _cut_out_part(image: Array, choice: BlobChoice, number: int) -> _BallPart:
    place = choice.place[number]
    spread = float(choice.spread[number])
    margin = int(np.ceil(2 * choice.radius[number] + 3 * spread)) + 4
    corner = np.maximum(0, place.astype(int) - margin)
    end = np.maximum(0, place.astype(int) + margin)
    return _BallPart(
        np.ascontiguousarray(image[corner[1] : end[1], corner[0] : end[0]]), corner, place, spread
    )


def _fit_ball_outline(part: _BallPart, radius: float, colour: HsvRange) -> outline.Outline | None:
    """The outline (px of the image) of a ball of that radius
    near its predicted place, if whole and of its colour.
    """
    import cv2

    if min(part.pixels.shape[:2]) < 2 * radius:
        return None
    reach = max(2.5, 2 * part.spread)
    circle = outline.fit_outline(
        part.pixels.astype(np.float32), part.place - part.corner, radius, reach
    )
    if circle is None:
        return None
    height, width = part.pixels.shape[:2]
    down, across = np.mgrid[:height, :width]
    inside = np.hypot(across - circle.u, down - circle.v) < 0.8 * radius
    seen = mask_of_range(cv2.cvtColor(part.pixels, cv2.COLOR_BGR2HSV), colour)[inside] > 0
    whole = min(circle.u, circle.v, width - 1 - circle.u, height - 1 - circle.v) >= 0.9 * radius
    if not whole or not seen.size or seen.mean() < _COLOURED:
        return None
    left, top = part.corner.tolist()
    return circle._replace(u=circle.u + left, v=circle.v + top)

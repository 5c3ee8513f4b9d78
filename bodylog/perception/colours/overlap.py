"""A second search where the arm's blob overlaps another
of its colour or is partly hidden: its outline decides.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ...types import Array, LazyImage
from ..tracking.joint_motion import thin_indices
from .blob_measurement import BORDER, FIELDS, MASS, STD_U, STD_V, STRENGTH, U, V
from .clutter import BlobChoice
from .hsv_ranges import HsvRange, mask_of_range

_COMPARED = 60
_FEWEST = 10
_FARTHEST = 0.02
"""Largest error of the predicted place, as a share of the image width."""
_COLOURED = 0.7
_RAYS = 64
_STEP = 0.25
_CONTRAST = 25.0
"""Grey levels between inside and outside, below which a ray shows no edge."""
_ENOUGH = 0.35
"""Share of the rays that must agree on one circle."""
_TURNS = 4
_ROBUST = 5
_LEAST = 0.15
_AGREE = 0.6
"""px: edges this far from a circle are half as good as those upon it."""
_PULL = 3.0
"""Further rays that a circle at the farthest shift needs, compared with one at none."""


class Outline(NamedTuple):
    """A circle: centre u, v and std (px) of one coordinate;
    `excess` (px) by which edges lie beyond the radius.
    """

    u: float
    v: float
    std: float
    excess: float


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


def _row_from_outline(circle: Outline, offset: Array, radius: float, strength: float) -> Array:
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


def _fit_ball_outline(part: _BallPart, radius: float, colour: HsvRange) -> Outline | None:
    """The outline (px of the image) of a ball of that radius
    near its predicted place, if whole and of its colour.
    """
    import cv2

    if min(part.pixels.shape[:2]) < 2 * radius:
        return None
    reach = max(2.5, 2 * part.spread)
    circle = fit_outline(part.pixels.astype(np.float32), part.place - part.corner, radius, reach)
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


def fit_outline(image: Array, centre: Array, radius: float, reach: float) -> Outline | None:
    """The circle of `radius` px whose edge an image (H,W,3)
    shows within `reach` px of that about `centre` (2,) px.

    None where too little of it is visible.
    """
    scatter = _LEAST
    count = 0
    for turn in range(_TURNS):
        off = _radii_of_edges(image, centre, radius, reach) - radius
        step = _consensus_shift(off, reach) if turn == 0 else np.zeros(2)
        near = np.abs(off - _ray_directions() @ step) < 2 * _AGREE
        for _ in range(_ROBUST):
            count = int(near.sum())
            if count < _ENOUGH * _RAYS:
                return None
            step = np.linalg.lstsq(_ray_directions()[near], off[near], rcond=None)[0]
            rest = np.abs(off - _ray_directions() @ step)
            scatter = max(_LEAST, 1.4826 * float(np.median(rest[near])))
            near = rest <= min(3 * scatter, 2 * _AGREE)
        centre = centre + step
    return Outline(
        float(centre[0]),
        float(centre[1]),
        scatter * float(np.sqrt(2 / count)),
        float(np.median(off[near])),
    )


def _consensus_shift(off: Array, reach: float) -> Array:
    """The shift (2,) px, at most `reach` each way, that
    most rays' edges (R,) px beyond the circle agree on.
    """
    line = np.linspace(-reach, reach, 2 * int(np.ceil(reach / _AGREE)) + 1)
    shifts = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    away = (off[:, None] - _ray_directions() @ shifts.T) / _AGREE
    votes = np.where(np.isfinite(away), np.exp(-0.5 * away**2), 0).sum(axis=0)
    return np.asarray(shifts[int(np.argmax(votes - _PULL * np.hypot(*shifts.T) / reach))])


@lru_cache
def _ray_directions() -> Array:
    turn = 2 * np.pi * np.arange(_RAYS) / _RAYS
    return np.column_stack([np.cos(turn), np.sin(turn)])


def _radii_of_edges(image: Array, centre: Array, radius: float, reach: float) -> Array:
    """The radius (px) at which each ray crosses half way from
    the ball's colour to its surround; NaN without an edge.

    Both colours are the ray's own, so that shading across the ball moves no edge.
    """
    import cv2

    out = np.arange(0.4 * radius, 1.4 * radius + reach + 2, _STEP)
    u, v = (centre[axis] + _ray_directions()[:, axis, None] * out for axis in (0, 1))
    at = u.astype(np.float32), v.astype(np.float32)
    seen = cv2.remap(image, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inner = out < 0.85 * radius - 0.5 * reach
    outer = out > radius + reach + 0.5
    inner[: max(3, int(0.15 * radius / _STEP))] = True
    inside = np.median(seen[:, inner], axis=1)
    outside = np.median(seen[:, outer], axis=1)
    away = inside - outside
    square = np.maximum((away * away).sum(axis=1), 1.0)
    share = np.einsum("rkc,rc->rk", seen - outside[:, None], away) / square[:, None]
    first = int(np.flatnonzero(inner)[-1])
    below = share[:, first:] < 0.5
    k = below.argmax(axis=1) + first
    rows = np.arange(_RAYS)
    high = share[rows, k - 1]
    low = share[rows, k]
    edge = out[k - 1] + _STEP * np.clip((high - 0.5) / np.maximum(high - low, 1e-6), 0, 1)
    return np.where(below.any(axis=1) & (np.sqrt(square) > _CONTRAST), edge, np.nan)

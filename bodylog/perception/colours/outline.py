"""The centre of a ball from its visible outline,
where something of its own colour touches or hides it.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ...types import Array

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
    high, low = share[rows, k - 1], share[rows, k]
    edge = out[k - 1] + _STEP * np.clip((high - 0.5) / np.maximum(high - low, 1e-6), 0, 1)
    return np.where(below.any(axis=1) & (np.sqrt(square) > _CONTRAST), edge, np.nan)

"""Corners where two dark and two light squares meet,
to a fraction of a pixel, with their covariance.
"""

from typing import NamedTuple

import numpy as np

from ...types import Array
from .quads import sample_gray

_HALF = 7
"""Samples on each side of a corner; they lie as far apart as its window is wide."""
_TURNS = 4
_FLOOR = 0.015
"""px: systematic error shared by all edges of a corner, as of a tag."""
_EXCESS = 2.0
"""Factor on the Cramér-Rao bound, from drawn boards."""


class Corners(NamedTuple):
    """uv (K,2) px, NaN where there is no corner within the window · cov (K,2,2) px²."""

    uv: Array
    cov: Array


def refine_saddles(gray: Array, uv: Array, reach: Array) -> Corners:
    """Corners near uv (K,2) px, each within a window of half its `reach` (K,) px to every side.

    Least squares: every gradient in the window is perpendicular
    to its line to the corner (Förstner & Gülch 1987).
    """
    place = uv.copy()
    cov = np.full((len(uv), 2, 2), np.nan)
    offsets = np.linspace(-1, 1, 2 * _HALF + 1)
    grid = np.stack(np.meshgrid(offsets, offsets), axis=-1)
    weight = np.exp(-(grid**2).sum(axis=2))[1:-1, 1:-1]
    for _ in range(_TURNS):
        step, cov = _step_to_saddle(gray, place, reach, grid, weight)
        place = place + np.clip(step, -reach[:, None], reach[:, None])
    far = np.linalg.norm(place - uv, axis=1) > reach
    return Corners(np.where(far[:, None], np.nan, place), cov)


def _step_to_saddle(
    gray: Array, place: Array, reach: Array, grid: Array, weight: Array
) -> tuple[Array, Array]:
    """The step from each place (K,2) px to the crossing of
    the gradients around it, and its covariance (K,2,2) px².
    """
    points = place[:, None, None] + reach[:, None, None, None] * grid
    levels = sample_gray(gray, points)
    spacing = (reach / _HALF)[:, None, None]
    gu = (levels[:, 1:-1, 2:] - levels[:, 1:-1, :-2]) / (2 * spacing)
    gv = (levels[:, 2:, 1:-1] - levels[:, :-2, 1:-1]) / (2 * spacing)
    gradient = np.stack([gu, gv], axis=-1).reshape(len(place), -1, 2)
    apart = (points[:, 1:-1, 1:-1] - place[:, None, None]).reshape(len(place), -1, 2)
    some = weight.ravel()[:, None, None]
    normal = (some * gradient[..., None] * gradient[..., None, :]).sum(axis=1)
    along = (gradient * apart).sum(axis=2)
    inverse = _invert_symmetric(normal)
    step = (inverse @ (some[..., 0] * gradient * along[..., None]).sum(axis=1)[..., None])[..., 0]
    # a perfect corner is symmetric under half a turn: the difference is noise
    noise = ((levels - levels[:, ::-1, ::-1]) ** 2).mean(axis=(1, 2)) / 2
    apart_px = np.minimum(reach / _HALF, 1.0) ** 2
    cov = (_EXCESS * noise / apart_px)[:, None, None] * inverse + _FLOOR**2 * np.eye(2)
    return np.nan_to_num(step, nan=np.inf, posinf=np.inf), cov


def _invert_symmetric(matrix: Array) -> Array:
    """Inverse of symmetric (K,2,2); NaN where one is singular."""
    a = matrix[:, 0, 0]
    b = matrix[:, 0, 1]
    c = matrix[:, 1, 1]
    det = a * c - b * b
    det = np.where(det > 1e-6 * (a + c) ** 2, det, np.nan)
    return (
        np.stack([np.stack([c, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=1)
        / det[:, None, None]
    )

"""Corners of dark squares to a fraction of a pixel:
straight lines through the edges of their four sides.
"""

from typing import NamedTuple

import numpy as np

from ...types import Array
from .quads import sample_gray

_SAMPLES = 24
_STEP = 0.5
_AT_ONCE = 64
_ENDS = 0.12
"""Share of a side left out at each end: blur rounds corners."""
_LEAST_SHARE = 0.4
"""Share of a side's samples that must show the edge."""
_RELIEF = 0.4
"""Share of the square's contrast that a sample must show."""
_OUTLYING = 3.0
_REACH = 0.8
_LEAST_REACH = 1.5
_CLOSE = 3.0
"""Search range of an edge on both sides of its expected
line: in cells; px at least; px in the last round.
"""
_MOST_STEPS = 20
_LEAST_ROOM = 1.0
_FLOOR = 0.015
_PULL = 4.5
_CLEAR = 0.165
_ALIKE = 0.6
"""Systematic error of a whole side, px: at least; from a neighbouring edge, which grows as the
square of blur per cell above a limit; the share in which opposite sides differ. From drawn tags of
16 to 100 px, blur 0.3 to 1.4 px, noise 1 to 6 gray levels, light from one side or none."""


class Refined(NamedTuple):
    """quads (M,4,2) px · cov of each corner (M,4,2,2) and
    of the centre (M,2,2) px² · sides (M,4) bool: seen.

    blur (M,4) px: the standard deviation of the step at each side.
    """

    quads: Array
    corner_cov: Array
    centre_cov: Array
    sides: Array
    blur: Array


_NONE = Refined(
    np.empty((0, 4, 2)),
    np.empty((0, 4, 2, 2)),
    np.empty((0, 2, 2)),
    np.empty((0, 4), bool),
    np.empty((0, 4)),
)


def refine_quads(gray: Array, quads: Array, cell: Array) -> Refined:
    """Move quads (M,4,2), clockwise, to the edges near them;
    beside an edge the image is uniform for `cell` (M,) px.

    Edges are searched within a cell first, then again close by, where light changes little.
    """
    parts = [
        _refine_some_quads(gray, quads[k : k + _AT_ONCE], cell[k : k + _AT_ONCE])
        for k in range(0, len(quads), _AT_ONCE)
    ]
    return (
        Refined(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        if parts
        else _NONE
    )


def _refine_some_quads(gray: Array, quads: Array, cell: Array) -> Refined:
    reach = np.maximum(_REACH * cell, _LEAST_REACH)
    near = _refine_quads_once(gray, quads, cell, _reach_within_image(gray, quads, reach))
    return _refine_quads_once(
        gray, near.quads, cell, _reach_within_image(gray, near.quads, np.minimum(reach, _CLOSE))
    )


def _reach_within_image(gray: Array, quads: Array, reach: Array) -> Array:
    """The reach (M,) px, less where quads are near the image's border."""
    room = np.minimum(quads, np.array(gray.shape[::-1]) - 1 - quads).min(axis=(1, 2))
    return np.where(room >= _LEAST_ROOM, np.minimum(reach, room), reach)


def _refine_quads_once(gray: Array, quads: Array, cell: Array, reach: Array) -> Refined:
    start = quads
    end = np.roll(quads, -1, axis=1)
    along = end - start
    length = np.maximum(np.linalg.norm(along, axis=2), 1e-6)
    along = along / length[..., None]
    outward = np.stack([along[..., 1], -along[..., 0]], axis=-1)  # clockwise with v down
    x = (np.linspace(_ENDS, 1 - _ENDS, _SAMPLES) - 0.5) * length[..., None]
    steps = min(int(np.ceil(reach.max() / _STEP)), _MOST_STEPS)
    taps = np.linspace(-1, 1, 2 * steps + 1) * reach[:, None]
    middle = (start + end) / 2
    base = middle[:, :, None] + x[..., None] * along[:, :, None]
    points = base[:, :, :, None] + taps[:, None, None, :, None] * outward[:, :, None, None]
    profile = sample_gray(gray, points)
    place, shown, blur, doubt = _locate_edges(profile, taps, x)
    offset, slope, variance = _fit_robust_lines(x, place, shown)
    variance[..., 0] += _FLOOR**2 + doubt
    pull = cell[:, None] * _PULL * np.maximum(blur / cell[:, None] - _CLEAR, 0) ** 2
    seen = np.isfinite(offset)
    offset = np.where(seen, offset, 0.0)
    slope = np.where(seen, slope, 0.0)
    corners, cov = _cross_lines(middle, along, outward, offset, slope, variance, pull, length)
    centre_cov = _centre_cov(outward, variance[..., 0] + (_ALIKE * pull) ** 2)
    return Refined(corners, cov, centre_cov, seen, blur)


def _locate_edges(profile: Array, taps: Array, x: Array) -> tuple[Array, Array, Array, Array]:
    """Edge of each profile (M,4,S,T), from dark to light,
    (M,4,S) px; whether it has one; each side's blur (M,4) px.

    Last the variance (M,4) px² from the noise of the black and white levels.
    """
    inside = np.asarray(np.isfinite(profile).all(axis=3))
    usual = np.where(inside[..., None], profile, 0).sum(axis=2) / np.maximum(
        inside.sum(axis=2)[..., None], 1
    )
    step = (taps[:, 1] - taps[:, 0])[:, None, None]
    half = profile.shape[3] // 2
    low = usual[..., : half + 1].argmin(axis=2)
    high = half + usual[..., half:].argmax(axis=2)
    (black, unsure), (white, as_unsure) = (
        _gray_level_at_tap(profile, at, x, inside) for at in (low, high)
    )
    relief = np.maximum(white - black, 1)
    number = np.arange(profile.shape[3])
    within = (number >= low[..., None]) & (number <= high[..., None])
    # the area between the white level and the profile: the same for any symmetric blur
    share = np.where(within[:, :, None], white[..., None] - profile, 0) / relief[..., None]
    first = np.take_along_axis(np.broadcast_to(taps[:, None], usual.shape), low[..., None], 2)[
        ..., 0
    ]
    place = first[..., None] - step / 2 + share.sum(axis=3) * step
    own = np.take_along_axis(profile, high[:, :, None, None], 3) - np.take_along_axis(
        profile, low[:, :, None, None], 3
    )
    contrast = np.median(relief, axis=(1, 2))
    doubt = (unsure + as_unsure) * (taps[:, -1] / np.maximum(contrast, 1))[:, None] ** 2
    return (
        place,
        inside & (own[..., 0] > _RELIEF * contrast[:, None, None]),
        _blur_of_steps(usual, taps, within),
        doubt,
    )


def _gray_level_at_tap(profile: Array, at: Array, x: Array, inside: Array) -> tuple[Array, Array]:
    """The gray level (M,4,S) of profiles (M,4,S,T) at one tap of each side, and its variance (M,4).

    It is a straight line along the side, because light varies.
    """
    own = np.take_along_axis(profile, at[:, :, None, None], 3)[..., 0]
    offset, slope, count, _ = _fit_weighted_line(x, own, inside.astype(float))
    level = offset[..., None] + slope[..., None] * x
    rest = np.where(inside, own - level, 0)
    return level, (rest**2).sum(axis=2) / np.maximum(count * (count - 2), 1)


def _blur_of_steps(usual: Array, taps: Array, within: Array) -> Array:
    """The standard deviation (M,4) px of the steps of mean profiles (M,4,T)."""
    rise = np.maximum(np.diff(usual, axis=2), 0) * within[..., 1:]
    share = rise / np.maximum(rise.sum(axis=2, keepdims=True), 1e-9)
    middle = ((taps[:, 1:] + taps[:, :-1]) / 2)[:, None]
    mean = (share * middle).sum(axis=2, keepdims=True)
    return np.asarray(np.sqrt((share * (middle - mean) ** 2).sum(axis=2)))


def _fit_robust_lines(x: Array, place: Array, shown: Array) -> tuple[Array, Array, Array]:
    """Offset (M,4) px and slope of straight lines place
    = offset + slope x, and variances (M,4,2) of the two.
    """
    weight = shown.astype(float)
    for _ in range(3):
        offset, slope, count, spread = _fit_weighted_line(x, place, weight)
        rest = np.abs(place - offset[..., None] - slope[..., None] * x)
        scale = np.sqrt(
            (weight * np.where(weight > 0, rest, 0) ** 2).sum(axis=2) / np.maximum(count - 2, 1)
        )
        weight = np.where(shown & (rest <= np.maximum(_OUTLYING * scale, 0.1)[..., None]), 1.0, 0.0)
    offset = np.where(count >= _LEAST_SHARE * _SAMPLES, offset, np.nan)
    variance = scale[..., None] ** 2 / np.stack(
        [np.maximum(count, 1), np.maximum(spread, 1e-9)], axis=-1
    )
    return offset, slope, variance


def _fit_weighted_line(x: Array, place: Array, weight: Array) -> tuple[Array, Array, Array, Array]:
    place = np.where(weight > 0, place, 0)
    count = weight.sum(axis=2)
    n = np.maximum(count, 1)
    mean_x = (weight * x).sum(axis=2) / n
    mean = (weight * place).sum(axis=2) / n
    apart = x - mean_x[..., None]
    spread = (weight * apart**2).sum(axis=2)
    slope = (weight * apart * place).sum(axis=2) / np.maximum(spread, 1e-9)
    return mean - slope * mean_x, slope, count, spread


def _cross_lines(
    middle: Array,
    along: Array,
    outward: Array,
    offset: Array,
    slope: Array,
    variance: Array,
    pull: Array,
    length: Array,
) -> tuple[Array, Array]:
    """Crossings of neighbouring lines (M,4,2) px, and their covariance (M,4,2,2) px²."""
    normal = outward - slope[..., None] * along
    level = (normal * (middle + offset[..., None] * outward)).sum(axis=2)
    before = np.roll(normal, 1, axis=1)
    matrix = np.stack([before, normal], axis=2)
    inverse = np.linalg.pinv(matrix)
    corners = (inverse @ np.stack([np.roll(level, 1, axis=1), level], axis=2)[..., None])[..., 0]
    at_end = variance[..., 0] + pull**2 + variance[..., 1] * (length / 2) ** 2
    spread = np.stack([np.roll(at_end, 1, axis=1), at_end], axis=2)
    return corners, inverse @ (spread[..., None] * np.swapaxes(inverse, 2, 3))


def _centre_cov(outward: Array, variance: Array) -> Array:
    """Covariance of the centre, midway between opposite sides: (M,2,2) px²."""
    inverse = np.linalg.pinv(
        np.stack([outward[:, 1] - outward[:, 3], outward[:, 0] - outward[:, 2]], axis=1) / 2
    )
    spread = (
        np.stack([variance[:, 1] + variance[:, 3], variance[:, 0] + variance[:, 2]], axis=1) / 4
    )
    return np.asarray(inverse @ (spread[..., None] * np.swapaxes(inverse, 1, 2)))

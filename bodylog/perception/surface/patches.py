"""Small pictures of landmarks, looked for in images where
they are predicted, turned and scaled as they would look.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from ...body_model import PATCH_PX
from ...types import Array

_TEMPLATE_PX = 17
"""Side of what is looked for: at 45° it still lies within a picture."""
LEAST_ALIKE = 0.8
"""Normalised cross-correlation of a landmark that is found again."""
LEAST_LEAD = 0.05
"""Correlation by which a place leads every other one in reach."""
_APART_PX = 3
"""Places nearer than this are one peak."""
_LEAST_CONTRAST = 6.0
"""Standard deviation, grey levels, of a picture that tells one place from another."""
_MOST_STRETCH = 2.0
"""Scale, or its inverse, beyond which a picture no longer shows what the image does."""
_BEYOND_PX = 2.0
"""How far beyond a picture's rim a template may reach."""


@dataclass(frozen=True, eq=False)
class PatchMatches:
    """Where templates (n,) were found in an image: uv
    (n,2) px · score (n,), correlation · sure (n,).
    """

    uv: Array
    score: Array
    sure: Array


def cut_patch(image: Array, uv: Array) -> Array | None:
    """The picture (PATCH_PX,PATCH_PX) uint8 around uv (2,)
    px of a grey image; None at its rim, or without contrast.
    """
    half = PATCH_PX / 2.0
    height, width = image.shape
    if not (half <= uv[0] < width - half and half <= uv[1] < height - half):
        return None
    patch = cv2.getRectSubPix(image, (PATCH_PX, PATCH_PX), (float(uv[0]), float(uv[1])))
    return np.asarray(patch) if patch.std() >= _LEAST_CONTRAST else None


def warp_patches(patches: Array, maps: Array) -> tuple[Array, Array]:
    """Templates (n,s,s) uint8 of pictures (n,S,S) as an
    image would show them, and whether each can be made (n,).

    maps (n,2,2): the derivative of a place in the image by its place in the picture.
    """
    count = len(patches)
    half = _TEMPLATE_PX // 2
    scale = np.sqrt(np.abs(np.linalg.det(maps)))
    fit = (scale < _MOST_STRETCH) & (scale > 1.0 / _MOST_STRETCH)
    inverse = np.linalg.inv(np.where(fit[:, None, None], maps, np.eye(2)))
    fit &= half * np.abs(inverse).sum(axis=2).max(axis=1) <= PATCH_PX // 2 + _BEYOND_PX
    begin = PATCH_PX // 2 - half * inverse.sum(axis=2, keepdims=True)
    to_picture = np.concatenate([inverse, begin], axis=2)
    size = (_TEMPLATE_PX, _TEMPLATE_PX)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    templates = np.zeros((count, *size), np.uint8)
    for number in np.flatnonzero(fit):
        templates[number] = cv2.warpAffine(
            patches[number], to_picture[number], size, flags=flags, borderMode=cv2.BORDER_REPLICATE
        )
    fit &= templates.reshape(count, -1).std(axis=1) >= _LEAST_CONTRAST
    return templates, fit


def match_templates(image: Array, templates: Array, uv: Array, reach_px: int) -> PatchMatches:
    """Look for templates (n,s,s) in a grey image (H,W)
    within reach_px of uv (n,2) px, to a part of a pixel.
    """
    half = _TEMPLATE_PX // 2
    found = uv.astype(float)
    score = np.full(len(uv), -1.0)
    sure = np.zeros(len(uv), bool)
    height, width = image.shape
    for number, (u, v) in enumerate(np.rint(uv).astype(int).tolist()):
        left = u - reach_px - half
        top = v - reach_px - half
        right = u + reach_px + half + 1
        bottom = v + reach_px + half + 1
        if left < 0 or top < 0 or right > width or bottom > height:
            continue
        correlation = cv2.matchTemplate(
            image[top:bottom, left:right], templates[number], cv2.TM_CCOEFF_NORMED
        )
        row, column = divmod(int(correlation.argmax()), correlation.shape[1])
        best = correlation.item(row, column)
        score[number] = best
        if best < LEAST_ALIKE or row in (0, 2 * reach_px) or column in (0, 2 * reach_px):
            continue
        beside = correlation.item(row, column - 1), correlation.item(row, column + 1)
        above = correlation.item(row - 1, column)
        below = correlation.item(row + 1, column)
        found[number] = (
            column + left + half + _vertex(beside[0], best, beside[1]),
            row + top + half + _vertex(above, best, below),
        )
        correlation[
            max(row - _APART_PX, 0) : row + _APART_PX + 1,
            max(column - _APART_PX, 0) : column + _APART_PX + 1,
        ] = -1.0
        sure[number] = best - float(correlation.max()) >= LEAST_LEAD
    return PatchMatches(found, score, sure)


def _vertex(before: float, peak: float, after: float) -> float:
    """Where the parabola through three neighbours is highest, −½ to ½."""
    bend = before - 2.0 * peak + after
    return 0.0 if bend >= 0.0 else min(max(0.5 * (before - after) / bend, -0.5), 0.5)

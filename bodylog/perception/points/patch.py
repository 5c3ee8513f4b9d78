"""A patch of one image aligned with other images: an
affine map, by least squares, with its covariance.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...types import Array
from ..tags.quads import sample_gray

_TURNS = 15
_STILL = 0.01
_EXCESS = 2.5
"""Factor on the variance of independent pixels: errors of neighbouring pixels are correlated."""
_FLOOR = 0.015
_STRETCHED = 0.08
"""px of the first image: the error shared by all pixels of a
patch, and its increase per factor e of stretch or shrinkage."""
_LEAST_EDGE = 20.0
"""Least sum of squared gradients across the patch's
weakest direction, per px and gray level squared.
"""


class Laid(NamedTuple):
    """A patch's placement: map (2,3) from px around its
    middle to px · correlation 0..1 · cov (2,2) px².
    """

    map: Array
    correlation: float
    cov: Array

    @property
    def uv(self) -> Array:
        """The patch's middle (2,) px."""
        return np.asarray(self.map[:, 2])


@dataclass(frozen=True, eq=False)
class Patch:
    """The pixels within `half` px of a place: grid (n,2) px
    around it · levels (n,) · solve (8,n): least squares.
    """

    half: int
    grid: Array
    levels: Array
    columns: Array
    solve: Array
    inverse: Array

    @property
    def edge(self) -> float:
        """The patch's texture in its weakest direction: below 1 it cannot be tracked."""
        gradient = self.columns[:, 4:6]
        return float(np.linalg.eigvalsh(gradient.T @ gradient)[0] / len(self.grid) / _LEAST_EDGE)


def cut_patch(gray: Array, uv: Array, half: int) -> Patch | None:
    """The patch about a place (2,) px; None where it leaves the image."""
    side = np.arange(-half, half + 1.0)
    grid = np.stack(np.meshgrid(side, side), axis=-1)
    about = sample_gray(gray, grid + uv)
    if not np.isfinite(about).all():
        return None
    down, across = np.gradient(about)
    x = grid[..., 0].ravel()
    y = grid[..., 1].ravel()
    levels = about.ravel()
    gu = across.ravel()
    gv = down.ravel()
    columns = np.stack(
        [gu * x, gu * y, gv * x, gv * y, gu, gv, levels, np.ones_like(levels)], axis=1
    )
    inverse = np.linalg.pinv(columns.T @ columns)
    return Patch(half, grid.reshape(-1, 2), levels, columns, np.linalg.pinv(columns), inverse)


def map_at_place(uv: Array) -> Array:
    """The map (2,3) of a patch that lies upright at a place (2,) px."""
    return np.column_stack([np.eye(2), uv])


def align_patch(gray: Array, patch: Patch, begin: Array) -> Laid | None:
    """Align the patch with the image near a map (2,3), in any light; None where it leaves the
    image.

    None also where it would turn too far from the camera. Inverse compositional Gauss-Newton (Baker
    & Matthews 2004) with gain and offset of the light.
    """
    map_ = begin
    for _ in range(_TURNS):
        levels = sample_gray(gray, (patch.grid @ map_[:, :2].T + map_[:, 2])[None])[0]
        if not np.isfinite(levels).all():
            return None
        found = patch.solve @ levels
        if found[6] <= 0.1:
            return None
        by = found[:6] / found[6]
        map_ = _compose_with_inverse(map_, by)
        if not _is_sound_map(map_):
            return None
        if np.abs(by[4:]).max() < _STILL:
            break
    rest = levels - patch.columns @ found
    apart = levels - levels.mean()
    correlation = 1 - (rest @ rest) / max(float(apart @ apart), 1e-9)
    variance = _EXCESS * (rest @ rest) / (len(rest) - 8) / found[6] ** 2
    shared = _FLOOR + _STRETCHED * float(
        np.abs(np.log(np.linalg.svd(map_[:, :2], compute_uv=False))).max()
    )
    cov = map_[:, :2] @ (variance * patch.inverse[4:6, 4:6] + shared**2 * np.eye(2)) @ map_[:, :2].T
    return Laid(map_, float(np.sqrt(max(correlation, 0.0))), cov)


def draw_patch(patch: Patch, map_: Array) -> Array:
    """The patch (2 half + 1)² uint8 after a map (2,3) about its middle."""
    import cv2

    size = 2 * patch.half + 1
    turned = map_[:, :2]
    whole = np.column_stack([turned, patch.half - turned @ (patch.half, patch.half)])
    levels = patch.levels.reshape(size, size).astype(np.float32)
    seen = cv2.warpAffine(
        levels, whole, (size, size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(np.clip(np.rint(seen), 0, 255).astype(np.uint8))


def _compose_with_inverse(map_: Array, by: Array) -> Array:
    """The map after the inverse of x -> x + (a x + b y + e, c x + d y + f)."""
    turn = np.eye(2) + by[:4].reshape(2, 2)
    inverse = np.linalg.pinv(turn)
    return np.column_stack([map_[:, :2] @ inverse, map_[:, 2] - map_[:, :2] @ inverse @ by[4:]])


def _is_sound_map(map_: Array) -> bool:
    """Whether the map neither mirrors the patch nor
    stretches it more than a view from the side does.
    """
    wide, thin = np.linalg.svd(map_[:, :2], compute_uv=False)
    return bool(np.linalg.det(map_[:, :2]) > 0 and thin > 0.3 and wide < 3.0 and wide / thin < 3.0)

"""The centre of one blob to a fraction of a pixel, and how far it may be off.

The centre is that of the blob's mixing weight: how far each pixel lies from the surround's colour towards the blob's
own, which an anti-aliased or blurred edge crosses linearly and a mask does not.
"""

from functools import lru_cache

import numpy as np

from ..types import Array

_SOFT, _GUARD = 3, 2
_DEADBAND, _FULL = 0.15, 0.97
_CORRELATED = 9.0
_FEWEST, _MANY = 12, 2000
_QUIETEST = 0.001
_DOUBT = 1 / 7
_ERODE = np.ones((5, 5), dtype=np.uint8)
_GROW = np.ones((2 * _SOFT + 1, 2 * _SOFT + 1), dtype=np.uint8)
_CLEAR = np.ones((2 * (_SOFT + _GUARD) + 1, 2 * (_SOFT + _GUARD) + 1), dtype=np.uint8)


def measure(window: Array, core: Array) -> tuple[float, float, float, float, float, float]:
    """u, v, std_u, std_v (px, in window (H,W,3) BGR), area (px²) and contrast (grey levels) of the blob around core.

    `core` (H,W) uint8 is 1 where the pixel surely is the blob's.
    """
    import cv2

    inner = cv2.erode(core, _ERODE)
    inner = inner if cv2.countNonZero(inner) >= _FEWEST else core
    grown = cv2.dilate(core, _GROW)
    outer = 1 - cv2.dilate(core, _CLEAR)
    x, y = _powers(window.shape[1]), _powers(window.shape[0])
    mixing, contrast = _mixing(window, inner, outer)
    mean, shade = _shade(mixing, inner.astype(np.float32), x, y)
    weight = _weight(mixing / (mean if shade is None else shade), grown)
    mass, u, v = _centroid(weight, x, y)
    doubt_u = doubt_v = 0.0
    if shade is not None:
        _, flat_u, flat_v = _centroid(_weight(mixing / mean, grown), x, y)
        # shading is not a plane: a part of what the plane corrects stays in doubt
        doubt_u, doubt_v = _DOUBT * (u - flat_u), _DOUBT * (v - flat_v)
    noise = _QUIETEST**2 + _ripple(weight, mass, u, v)
    return u, v, (noise + doubt_u**2) ** 0.5, (noise + doubt_v**2) ** 0.5, mass, contrast


@lru_cache(maxsize=512)
def _powers(size: int) -> Array:
    """1, x, x² of the pixels of a row or column: (3,size)."""
    x = np.arange(size, dtype=np.float32)
    return np.stack([np.ones_like(x), x, x * x])


def _mixing(window: Array, inner: Array, outer: Array) -> tuple[Array, float]:
    """0 at the surround's mean colour, 1 at the blob's, linear between and beyond (H,W); how far apart they are.

    Fisher's discriminant: the direction in colour that tells the two apart best given how each of them scatters, so
    that what else stands in the surround weighs little.
    """
    some = slice(None, None, 2 if inner.size > _MANY else 1)
    blob, blob_scatter = _moments(window[some, some][inner[some, some].view(bool)])
    ground, ground_scatter = _moments(window[::2, ::2][outer[::2, ::2].view(bool)])
    step, scatter = blob - ground, blob_scatter + ground_scatter
    # as much again of white noise keeps the direction sane where the colours hardly scatter
    scatter += max(float(scatter.trace()) / 3, 1e-3) * np.eye(3, dtype=np.float32)
    axis = np.linalg.solve(scatter, step)
    axis /= max(float(axis @ step), 1e-6)
    flat = window.reshape(-1, 3).astype(np.float32) @ axis - ground @ axis
    return flat.reshape(inner.shape), max(float(step @ step), 1.0) ** 0.5


def _moments(colours: Array) -> tuple[Array, Array]:
    """Mean (3,) and covariance (3,3) of colours (n,3); zeros of none."""
    shared = np.float32(1 / max(len(colours), 1))
    mean = np.full(len(colours), shared) @ colours.astype(np.float32)
    away = colours - mean
    return mean, away.T @ away * shared


def _shade(mixing: Array, inner: Array, x: Array, y: Array) -> tuple[float, Array | None]:
    """The mean mixing of the blob, and where light grades it beyond chance, the plane (H,W) of that; else None."""
    (n, sx, sxx), (sy, sxy, _), (syy, _, _) = (y @ inner @ x.T).tolist()
    inside = mixing * inner
    (z, zx, _), (zy, _, _), _ = (y @ inside @ x.T).tolist()
    mean, mid_x, mid_y = z / n, sx / n, sy / n
    xx, yy, xy = sxx - sx * mid_x, syy - sy * mid_y, sxy - sx * mid_y
    xz, yz = zx - z * mid_x, zy - z * mid_y
    determinant = max(xx * yy - xy * xy, 1e-9)
    slope_x, slope_y = (yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant
    explained = slope_x * xz + slope_y * yz
    rest = float(np.vdot(inside, inside)) - z * mean - explained
    freedom = n / _CORRELATED - 3
    trust = 1 - 6 * rest / max(freedom * explained, 1e-12)
    if freedom <= 0 or trust <= 0:
        return mean, None
    plane = mean + trust * slope_x * (x[1] - mid_x) + trust * slope_y * (y[1] - mid_y)[:, None]
    return mean, np.clip(plane, 0.4, 2.0)


def _weight(mixing: Array, grown: Array) -> Array:
    """Covered share of each pixel, with what is little set to none: (H,W) 0..1."""
    weight = mixing - np.float32(_DEADBAND)
    weight *= np.float32(1 / (_FULL - _DEADBAND))
    np.minimum(weight, 1, out=weight)
    np.maximum(weight, 0, out=weight)
    weight *= grown
    return weight


def _centroid(weight: Array, x: Array, y: Array) -> tuple[float, float, float]:
    """Sum of the weights and their centre u, v."""
    (mass, u), (v, _) = (y[:2] @ weight @ x[:2].T).tolist()
    return mass, u / mass, v / mass


def _ripple(weight: Array, mass: float, u: float, v: float) -> float:
    """Variance (px²) of one coordinate of the centre, from the waves of orders 3 and 5 round the blob's outline.

    A wave of order 1 is a shift of the centre. An outline that is its own mirror image through the centre has no waves
    of odd order, so those are what noise, compression and the pixels' grid make; order 1 gets as much as they do.
    """
    rows, columns = weight.nonzero()
    away = np.empty(len(rows), dtype=np.complex64)
    away.real, away.imag = columns - u, rows - v
    radius = np.abs(away) + np.float32(1e-6)
    turn = away / radius
    twice = turn * turn
    third = turn * twice
    arm = weight[rows, columns] * radius
    waves = complex(third @ arm), complex((third * twice) @ arm)
    return sum(abs(wave) ** 2 for wave in waves) / (2 * len(waves)) / mass**2

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
_FEWEST, _MANY = 12, 3000
_QUIETEST = 0.005
# Shares of the surround's and of the blob's own noise that reach the centre: the blob covers half of its edge's
# surround, and compression errs more at an edge than inside. Both calibrated on drawn and recorded pictures.
_AROUND, _WITHIN = 0.6, 1.5
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
    lit = mixing / (mean if shade is None else shade)
    weight = _weight(lit, grown)
    mass, u, v = _centroid(weight, x, y)
    doubt_u = doubt_v = 0.0
    if shade is not None:
        _, flat_u, flat_v = _centroid(_weight(mixing / mean, grown), x, y)
        # shading is not a plane: a part of what the plane corrects stays in doubt
        doubt_u, doubt_v = _DOUBT * (u - flat_u), _DOUBT * (v - flat_v)
    count, square_u, square_v = _edge(weight, inner, x, y, u, v)
    around = _noise(mixing, outer, count / (2 * (np.pi * mass) ** 0.5))
    within = _deviation(lit[inner.view(bool)])
    noise = float(np.hypot(_AROUND * around, _WITHIN * within)) / (_FULL - _DEADBAND) / mass
    std_u = (_QUIETEST**2 + noise**2 * square_u + doubt_u**2) ** 0.5
    std_v = (_QUIETEST**2 + noise**2 * square_v + doubt_v**2) ** 0.5
    return u, v, std_u, std_v, mass, contrast


@lru_cache(maxsize=512)
def _powers(size: int) -> Array:
    """1, x, x² of the pixels of a row or column: (3,size)."""
    x = np.arange(size, dtype=np.float32)
    return np.stack([np.ones_like(x), x, x * x])


def _mixing(window: Array, inner: Array, outer: Array) -> tuple[Array, float]:
    """0 at the surround's mean colour, 1 at the blob's, linear between and beyond (H,W); how far apart they are."""
    import cv2

    blob = np.array(cv2.mean(window, inner)[:3], dtype=np.float32)
    ground = np.array(cv2.mean(window, outer)[:3], dtype=np.float32)
    apart = max(float((blob - ground) @ (blob - ground)), 1.0)
    axis = (blob - ground) / np.float32(apart)
    return window.astype(np.float32) @ axis - ground @ axis, apart**0.5


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


def _edge(weight: Array, inner: Array, x: Array, y: Array, u: float, v: float) -> tuple[float, float, float]:
    """How many pixels the blob's soft edge has, and the sums of their squared distances from u and from v."""
    edge = ((weight > 0) & (weight < 1) & (inner == 0)).astype(np.float32)
    (n, sx, sxx), (sy, _, _), (syy, _, _) = (y @ edge @ x.T).tolist()
    return n, max(sxx - 2 * u * sx + u * u * n, 0.0), max(syy - 2 * v * sy + v * v * n, 0.0)


def _noise(mixing: Array, outer: Array, band: float) -> float:
    """Standard deviation of the mixing summed along a blob's edge `band` px wide, per square root of px.

    Neighbouring pixels err together over about 4 px along the edge, and over as many across as the edge is wide.
    """
    import cv2

    some = slice(None, None, 2 if outer.size < _MANY else 4)
    where = outer[some, some].view(bool)
    single = _deviation(mixing[some, some][where])
    square = 4.0 * _deviation(cv2.boxFilter(mixing, -1, (4, 4))[some, some][where])
    across = min(max((band - 1) / 3, 0.0), 1.0)
    return float(square ** (0.5 + 0.5 * across) * single ** (0.5 - 0.5 * across))


def _deviation(values: Array) -> float:
    """Standard deviation from the quartiles, which keeps out of it what else stands in the surround."""
    if len(values) < _FEWEST:
        return 1.0
    ordered = np.sort(values)
    return float(ordered[3 * len(ordered) // 4] - ordered[len(ordered) // 4]) / 1.349

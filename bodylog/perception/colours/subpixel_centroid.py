"""The centres of blobs to a fraction of a pixel, and their standard deviations.

The centre is that of the blob's mixing weight: how far each pixel lies from the surround's colour
towards the blob's own, which an anti-aliased or blurred edge crosses linearly and a mask does not.
K blobs are measured at once, each in a square of S×S px; the squares lie side by side on one sheet,
whose rows are long enough for OpenCV to be fast.
"""

from functools import lru_cache

import numpy as np

from ...types import Array

_SOFT = 3
_GUARD = 2
_DEADBAND = 0.15
_FULL = 0.97
_CORRELATED = 9.0
_FEWEST = 12
_MANY = 1000
_QUIETEST = 0.001
_ROUNDING = 1 / 12
"""Variance (grey levels²) of rounding to whole grey levels: no colour scatters less."""

# share of a lit ball's shift that a plane leaves: rms over lights 15 to 75 degrees off the view, 30
# to 70 % of the light from everywhere, and radii of 6 to 14 px
_UNEVEN = 0.16
# error of a lit ball's centre as a share of the shift between these levels: rms over 300 drawn
# ones, 6 to 14 px, under one light or two 15 to 75 degrees off the view, with 30 to 70 % of the
# light from everywhere, noise and compression
_LOW = 0.3
_HIGH = 0.7
_LEVELS = 0.6
# shifts that noise makes on flat discs are 2 to 4 times what the outline's ripple says
_SURE = 5.0
_ERODE = np.ones((5, 5), dtype=np.uint8)
_GROW = np.ones((2 * _SOFT + 1, 2 * _SOFT + 1), dtype=np.uint8)
_CLEAR = np.ones((2 * _GUARD + 1, 2 * _GUARD + 1), dtype=np.uint8)


def measure_centroids(
    sheet: Array, core: Array, valid: Array
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """u, v, std_u, std_v (px, in each square), area (px²)
    and contrast (grey levels) of K blobs: (K,) each.

    `sheet` is (S,K,S,3) BGR, `core` (S,K,S) uint8 is 1 where the pixel surely is the blob's,
    `valid` where there is a pixel at all. NaN where no weight is left.
    """
    inner, grown, outer = _blob_zones(core, valid)
    ground = _mean_colour(_colour_planes(sheet, 2), _contiguous_squares(outer[::2, :, ::2]))
    top, left, side = _bounding_square(grown)
    near = np.s_[top : top + side, :, left : left + side]
    inner, grown, core = (_contiguous_squares(each[near]) for each in (inner, grown, core))
    x = _powers_to_second(side)
    mixing, contrast = _mixing_ratio(sheet[near], inner, grown * (1 - core), ground)
    mean, plane, graded = _fit_shading(mixing, inner, x, _ROUNDING / contrast**2)
    weight = _covered_share(mixing / plane, grown)
    mass, u, v = _weighted_centroid(weight, x)
    variance = _QUIETEST**2 + _variance_by_outline(weight, mass, u, v)
    doubt = np.zeros((2, len(u)))
    if graded.any():
        flat = _covered_share(mixing[graded] / mean[graded, None, None], grown[graded])
        doubt[:, graded] = _UNEVEN * (np.stack([u, v])[:, graded] - _weighted_centroid(flat, x)[1:])
        shift = _shift_between_levels(mixing[graded] / plane[graded], grown[graded], x)
        clear = shift > _SURE * np.sqrt(variance[graded])
        variance[graded] += np.where(clear, (_LEVELS * shift) ** 2 / 2, 0)
    std_u, std_v = np.sqrt(variance + doubt**2)
    return u + left, v + top, std_u, std_v, mass, contrast


def _blob_zones(core: Array, valid: Array) -> tuple[Array, Array, Array]:
    """Masks of surely inside, perhaps inside and surely outside each blob: (S,K,S) uint8 each."""
    import cv2

    flat = core.reshape(len(core), -1)
    inner = cv2.erode(flat | (1 - valid).reshape(flat.shape), _ERODE).reshape(core.shape) & core
    few = count_pixels(inner) < _FEWEST
    inner[:, few] = core[:, few]
    grown = cv2.dilate(flat, _GROW)
    outer = valid & (1 - cv2.dilate(grown, _CLEAR).reshape(core.shape))
    return inner, grown.reshape(core.shape) & valid, outer


def _bounding_square(where: Array) -> tuple[int, int, int]:
    """Top, left and side (a multiple of 8) of the smallest
    square, of those in each (S,K,S), that holds all not 0.
    """
    down = np.flatnonzero(where.reshape(len(where), -1).max(axis=1))
    right = np.flatnonzero(where.max(axis=0).max(axis=0))
    side = -(-int(max(np.ptp(down), np.ptp(right)) + 1) // 8) * 8
    most = len(where) - side
    return min(int(down[0]), most), min(int(right[0]), most), side


def count_pixels(where: Array) -> Array:
    """How many of each square's pixels (S,K,S) uint8 are 1: (K,)."""
    return np.asarray(where.sum(axis=0, dtype=np.uint16).sum(axis=1, dtype=np.int64))


def _contiguous_squares(sheet: Array) -> Array:
    """A sheet's squares (s,K,t), each lying together: (K,s,t) float32."""
    return np.ascontiguousarray(sheet.swapaxes(0, 1), np.float32)


@lru_cache(maxsize=64)
def _powers_to_second(size: int) -> Array:
    """1, x, x² of the pixels of a row or column: (3,size)."""
    x = np.arange(size, dtype=np.float32)
    return np.stack([np.ones_like(x), x, x * x])


def _mixing_ratio(sheet: Array, inner: Array, rim: Array, ground: Array) -> tuple[Array, Array]:
    """0 at the surround's mean colour, 1 at the blob's, linear
    between and beyond (K,S,S); how far apart they are (K,).

    Fisher's discriminant: the direction in colour that separates the two best given the scatter of
    the blob and the rim around it, so that things beside the blob, and JPEG's bleeding colours,
    weigh little. Pixels mixed by the edge lie on the line between the two colours; scatter along
    that line turns no direction.
    """
    colours = _colour_planes(sheet)
    every = 2 if inner[0].size > _MANY else 1
    some = colours[:, :, ::every, ::every]
    inner = inner[:, ::every, ::every]
    rim = rim[:, ::every, ::every]
    blob = _mean_colour(some, inner)
    step = blob - ground
    scatter = _colour_covariance(some, inner, blob) + _colour_covariance(
        some, rim, _mean_colour(some, rim)
    )
    # as much white noise again keeps the direction stable where the colours hardly scatter
    white = np.maximum(np.trace(scatter, axis1=1, axis2=2) / 3, _ROUNDING)
    axis = np.linalg.solve(scatter + white[:, None, None] * np.eye(3), step[:, :, None])[:, :, 0]
    axis /= np.maximum((axis * step).sum(axis=1), 1e-6)[:, None]
    # eight lines at a time: too few for BLAS to start threads of its own
    lines = colours.reshape(len(colours), 3, -1, 8 * colours.shape[3]).swapaxes(1, 2)
    mixing = (axis.astype(np.float32)[:, None, None] @ lines).reshape(
        len(colours), *colours.shape[2:]
    )
    mixing -= (ground * axis).sum(axis=1).astype(np.float32)[:, None, None]
    return mixing, np.sqrt(np.maximum((step * step).sum(axis=1), 1.0))


def _colour_planes(sheet: Array, every: int = 1) -> Array:
    """The channels of every `every`-th pixel of squares
    (s,K,t,3) uint8: (K,3,s/every,t/every) float32, one by one.
    """
    import cv2

    lines = np.ascontiguousarray(sheet[::every])
    height, count, width, _ = lines.shape
    planes = np.empty((count, 3, height, -(-width // every)), np.float32)
    for index, channel in enumerate(cv2.split(lines.reshape(height, -1, 3))):
        planes[:, index] = channel.reshape(height, count, width)[:, :, ::every].swapaxes(0, 1)
    return planes


def _colour_covariance(colours: Array, where: Array, mean: Array) -> Array:
    """Covariance (K,3,3) of colours (K,3,s,t), whose mean (K,3) is known, where 1; zeros of none.

    Whole grey levels, counted from the one nearest to the mean, have sums that float64 holds
    exactly: they are alike on every processor, in whatever order it adds them, and what is
    subtracted is at most a quarter.
    """
    nearest = np.rint(mean).astype(np.float32)
    away = (colours - nearest[:, :, None, None]) * where[:, None]
    flat = away.reshape(len(away), 3, -1).astype(np.float64)
    count = np.maximum(where.sum(axis=(1, 2), dtype=np.float64), 1)[:, None, None]
    rest = flat.sum(axis=2, keepdims=True) / count
    return np.asarray(flat @ flat.transpose(0, 2, 1) / count - rest * rest.transpose(0, 2, 1))


def _mean_colour(colours: Array, where: Array) -> Array:
    """Mean (K,3) of colours (K,3,s,t) where 1; zeros of none."""
    chosen = where.reshape(len(where), -1, 1).astype(np.float32)
    sums = (colours.reshape(len(colours), 3, -1) @ chosen)[:, :, 0]
    return np.asarray(sums / np.maximum(chosen.sum(axis=1), 1), dtype=np.float64)


def _fit_shading(
    mixing: Array, inner: Array, x: Array, rounding: Array
) -> tuple[Array, Array, Array]:
    """Each blob's mean mixing (K,), its plane (K,S,S), and whether shading is significant (K,).

    `rounding` (K,) is the variance of mixing from whole grey levels alone.
    """
    n = inner.sum(axis=(1, 2), dtype=np.float64)
    columns = inner.sum(axis=1, dtype=np.float64)
    rows = inner.sum(axis=2, dtype=np.float64)
    mid_x = columns @ x[1] / n
    mid_y = rows @ x[1] / n
    mean = np.einsum("kij,kij->k", mixing, inner) / n
    # everything from its own middle: sums of squares less
    # the square of a sum lose the digits that matter
    across = x[1] - mid_x[:, None]
    beneath = x[1] - mid_y[:, None]
    level = (mixing - mean.astype(np.float32)[:, None, None]) * inner
    xx = (columns * across**2).sum(axis=1)
    yy = (rows * beneath**2).sum(axis=1)
    xy = ((inner @ across[:, :, None])[:, :, 0] * beneath).sum(axis=1)
    xz = (level.sum(axis=1) * across).sum(axis=1)
    yz = (level.sum(axis=2) * beneath).sum(axis=1)
    determinant = np.maximum(xx * yy - xy * xy, 1e-9 * xx * yy + 1e-9)
    slope_x = (yy * xz - xy * yz) / determinant
    slope_y = (xx * yz - xy * xz) / determinant
    explained = slope_x * xz + slope_y * yz
    rest = np.maximum(np.einsum("kij,kij->k", level, level) - explained, n * rounding)
    chance = rest / np.maximum((n / _CORRELATED - 3) * explained, 1e-12)
    trust = np.where(n > 3 * _CORRELATED, np.maximum(1 - 6 * chance, 0), 0)
    tilt_x = (trust * slope_x)[:, None]
    tilt_y = (trust * slope_y)[:, None]
    along = tilt_x * across
    down = tilt_y * beneath + mean[:, None]
    plane = along.astype(np.float32)[:, None, :] + down.astype(np.float32)[:, :, None]
    return mean.astype(np.float32), np.clip(plane, 0.4, 2.0, out=plane), trust > 0


def _shift_between_levels(share: Array, grown: Array, x: Array) -> Array:
    """The shift (px, K) of the centre from the part whose share
    (K,S,S) is above a low level to that above a high one.

    An edge that only blur softens is cut symmetrically at
    every level; light that fades towards a side is not.
    """
    low, high = (_weighted_centroid((share > level) * grown, x)[1:] for level in (_LOW, _HIGH))
    return np.asarray(np.hypot(*(high - low)))


def _moment_sums(field: Array, x: Array) -> Array:
    """Sums of y^i x^j field over each square, for the powers in x: (K,n,n) float64."""
    return np.asarray(x @ (field @ x.T), dtype=np.float64)


def _covered_share(mixing: Array, grown: Array) -> Array:
    """The covered share of each pixel, small ones set to 0: (K,S,S) 0..1."""
    mixing -= np.float32(_DEADBAND)
    mixing *= np.float32(1 / (_FULL - _DEADBAND))
    np.clip(mixing, 0, 1, out=mixing)
    mixing *= grown
    return mixing


def _weighted_centroid(weight: Array, x: Array) -> Array:
    """Sum of the weights of each square and their
    centre u, v: (3,K); NaN for squares without weight.
    """
    sums = _moment_sums(weight, x[:2])
    mass = np.where(sums[:, 0, 0] > 0, sums[:, 0, 0], np.nan)
    return np.stack([mass, sums[:, 0, 1] / mass, sums[:, 1, 0] / mass])


def _variance_by_outline(weight: Array, mass: Array, u: Array, v: Array) -> Array:
    """Variance (px², K) of one coordinate of each centre,
    from the waves of orders 3 and 5 round the blob's outline.

    A wave of order 1 is a shift of the centre. An outline that is its own
    mirror image through the centre has no waves of odd order, so noise,
    compression and the pixel grid make those; order 1 gets as much as they do.
    """
    x, y = (np.arange(weight.shape[1]) - np.stack([u, v])[:, :, None]).astype(np.float32)
    square = (y * y)[:, :, None] + (x * x)[:, None, :] + np.float32(1e-6)
    across = _powers_to_fifth(x)
    down = _powers_to_fifth(y)
    # a wave of order n is the sum of weight r (e^iφ)^n, with r e^iφ = x + iy
    weight = weight / square
    third = down[:, :4] @ (weight @ across[:, :4].transpose(0, 2, 1))
    weight /= square
    fifth = down @ (weight @ across.transpose(0, 2, 1))
    waves = [
        third[:, 0, 3] - 3 * third[:, 2, 1], 3 * third[:, 1, 2] - third[:, 3, 0],
        fifth[:, 0, 5] - 10 * fifth[:, 2, 3] + 5 * fifth[:, 4, 1],
        5 * fifth[:, 1, 4] - 10 * fifth[:, 3, 2] + fifth[:, 5, 0],
    ]  # fmt: skip
    return np.asarray(np.square(waves, dtype=np.float64).sum(axis=0) / 4 / mass**2)


def _powers_to_fifth(x: Array) -> Array:
    """1, x … x⁵ of (K,S): (K,6,S)."""
    powers = np.ones((len(x), 6, x.shape[1]), np.float32)
    for order in range(1, 6):
        np.multiply(powers[:, order - 1], x, out=powers[:, order])
    return powers

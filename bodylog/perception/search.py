"""Where each colour is in a picture: a search of every few pixels, and a window about each find."""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from ..types import Array
from .ranges import Range, mask

CANDIDATES = 4
_COARSE_WIDTH = 128
_FAINT = 0.25
_MARGIN = 10


class Window(NamedTuple):
    """Pixels (h,w,3) BGR about one find: of which picture and colour, from where, in what size (W,H) px of picture."""

    picture: int
    colour: int
    left: int
    top: int
    size: tuple[int, int]
    pixels: Array


def windows(picture: int, image: Array, ranges: Sequence[Range]) -> Iterator[Window]:
    """Windows about what may be each colour in an image (H,W,3) BGR, the picture of that number.

    At most CANDIDATES of each colour, without the image: it may go once they are taken.
    """
    height, width = image.shape[:2]
    step = max(1, round(width / _COARSE_WIDTH))
    seen = _table(tuple(ranges)).take(_every(image, step))
    for index in range(len(ranges)):
        for x, y, w, h in _boxes((seen & seen.dtype.type(1 << index) != 0).view(np.uint8)):
            left, top = max(0, (x - 1) * step - _MARGIN), max(0, (y - 1) * step - _MARGIN)
            part = image[top : (y + h) * step + _MARGIN, left : (x + w) * step + _MARGIN]
            yield Window(picture, index, left, top, (width, height), _copy(part))


@lru_cache
def _table(ranges: tuple[Range, ...]) -> Array:
    """A bit for each range in which a colour of 16 bits (65536,) may lie: the middle or a corner of its cell of BGR."""
    import cv2

    colours = np.arange(1 << 16, dtype=np.uint16).view(np.uint8).reshape(256, 256, 2)
    lowest = cv2.cvtColor(colours, cv2.COLOR_BGR5652BGR)
    table = np.zeros((256, 256), np.min_scalar_type((1 << len(ranges)) - 1))
    for within in ((4, 2, 4), *product((0, 7), (0, 3), (0, 7))):
        hsv = cv2.cvtColor(lowest + np.array(within, np.uint8), cv2.COLOR_BGR2HSV)
        for index, colour in enumerate(ranges):
            table[mask(hsv, colour) > 0] |= table.dtype.type(1 << index)
    return table.ravel()


def _every(image: Array, step: int) -> Array:
    """Every step-th pixel of every step-th row (H/step,W/step), its colour in 16 bits."""
    import cv2

    turned = image.strides[2] == -1
    some = _picked(image[..., ::-1] if turned else image, step)
    return np.asarray(cv2.cvtColor(some, getattr(cv2, _CODES[turned, some.shape[2]])).view(np.uint16)[..., 0])


_CODES = {
    (False, 3): "COLOR_BGR2BGR565", (False, 4): "COLOR_BGRA2BGR565",
    (True, 3): "COLOR_RGB2BGR565", (True, 4): "COLOR_RGBA2BGR565",
}  # fmt: skip


def _picked(image: Array, step: int) -> Array:
    """Every step-th pixel of every step-th row (H/step,W/step,3 or 4); a fourth byte means nothing."""
    height, width = max(1, image.shape[0] // step), image.shape[1] // step
    if step == 1 or not image.flags.c_contiguous:
        return np.ascontiguousarray(image[::step, ::step][:height, :width])
    # four bytes at a time is a third of the work; the last pixel taken has another after it, as step is above 1
    strides = (step * image.strides[0], step * image.strides[1])
    some = np.ndarray((height, width), np.uint32, image.data, 0, strides)
    return np.ascontiguousarray(some).view(np.uint8).reshape(height, width, 4)


def _copy(image: Array) -> Array:
    """A picture's pixels in memory of their own, BGR also where they were kept as RGB and are seen backwards."""
    import cv2

    return np.asarray(cv2.cvtColor(image[..., ::-1], cv2.COLOR_RGB2BGR)) if image.strides[2] == -1 else image.copy()


def _boxes(seen: Array) -> Iterator[tuple[int, int, int, int]]:
    """x, y, w, h of the largest components of a mask."""
    import cv2

    outlines = cv2.findContours(seen, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    largest = sorted(outlines, key=len, reverse=True)[:CANDIDATES]
    for outline in largest:
        if len(outline) >= _FAINT * len(largest[0]):
            x, y, w, h = cv2.boundingRect(outline)
            yield x, y, w, h

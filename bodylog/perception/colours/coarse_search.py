"""Find each colour in an image: a search of every few pixels, and a window around each find."""

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from ...types import Array
from .hsv_ranges import HsvRange, mask_of_range

CANDIDATES = 4
FAINT = 8
"""Further finds beside the CANDIDATES: much smaller than the largest, or surplus ones."""
_COARSE_WIDTH = 128
_SMALL = 0.25
_MARGIN = 8


class Window(NamedTuple):
    """Pixels (h,w,3) BGR around one find: its image and
    colour, left and top px, the image's size (W,H) px.

    `faint`: much smaller than the largest find, or surplus.
    """

    picture: int
    colour: int
    left: int
    top: int
    size: tuple[int, int]
    pixels: Array
    faint: bool


def convert_to_gray(image: Array) -> Array:
    """A picture (H,W,3) BGR in gray, (H,W) uint8, in memory of its own."""
    import cv2

    if _is_reversed_rgb(image):
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(image[..., ::-1]), cv2.COLOR_RGB2GRAY))
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_BGR2GRAY))


def find_windows(images: Mapping[int, Array], ranges: Sequence[HsvRange]) -> Iterator[Window]:
    """Windows around finds of each colour in images {number: (H,W,3) BGR}.

    At most CANDIDATES and FAINT ones per colour and
    image; they are copies, so the images may be freed.
    """
    of_shape: dict[tuple[tuple[int, ...], tuple[int, ...]], list[int]] = {}
    images = images if ranges else {}
    for picture, image in images.items():
        of_shape.setdefault((image.shape, image.strides), []).append(picture)
    for ((height, width, _), _), pictures in of_shape.items():
        step = max(1, round(width / _COARSE_WIDTH))
        seen = _search_coarsely([images[picture] for picture in pictures], step, tuple(ranges))
        for index in range(len(ranges)):
            for which, (x, y, w, h), faint in _component_boxes(
                (seen & seen.dtype.type(1 << index) != 0).view(np.uint8)
            ):
                left = max(0, (x - 1) * step - _MARGIN)
                top = max(0, (y - 1) * step - _MARGIN)
                image = images[pictures[which]]
                part = image[top : (y + h) * step + _MARGIN, left : (x + w) * step + _MARGIN]
                yield Window(
                    pictures[which], index, left, top, (width, height), _copy_as_bgr(part), faint
                )


@lru_cache
def _range_bits_of_colours(ranges: tuple[HsvRange, ...]) -> Array:
    """A bit for each range in which a colour of 16 bits
    (65536,) may lie: the middle or a corner of its cell of BGR.
    """
    import cv2

    colours = np.arange(1 << 16, dtype=np.uint16).view(np.uint8).reshape(256, 256, 2)
    lowest = cv2.cvtColor(colours, cv2.COLOR_BGR5652BGR)
    table = np.zeros((256, 256), np.min_scalar_type((1 << len(ranges)) - 1))
    for within in ((4, 2, 4), *product((0, 7), (0, 3), (0, 7))):
        hsv = cv2.cvtColor(lowest + np.array(within, np.uint8), cv2.COLOR_BGR2HSV)
        for index, colour in enumerate(ranges):
            table[mask_of_range(hsv, colour) > 0] |= table.dtype.type(1 << index)
    return table.ravel()


def _search_coarsely(images: Sequence[Array], step: int, ranges: tuple[HsvRange, ...]) -> Array:
    """Every step-th pixel of every step-th row of images of
    one shape, a bit for each range: (n,H/step+1,W/step).

    The last row of each is empty, so that no component continues into the next image.
    """
    import cv2

    turned = _is_reversed_rgb(images[0])
    some = np.stack(
        [_every_nth_pixel(image[..., ::-1] if turned else image, step) for image in images]
    )
    count, height, width = some.shape[:3]
    some = some.view(np.uint8).reshape(count * height, width, -1)
    code = getattr(cv2, _CODES[turned, some.shape[2]])
    seen = (
        _range_bits_of_colours(ranges)
        .take(cv2.cvtColor(some, code).view(np.uint16)[..., 0])
        .reshape(count, height, width)
    )
    return np.concatenate([seen, np.zeros_like(seen[:, :1])], axis=1)


def _is_reversed_rgb(image: Array) -> bool:
    """Whether an image is a reversed view of RGB."""
    return image.strides[2] == -1


_CODES = {
    (False, 3): "COLOR_BGR2BGR565",
    (False, 4): "COLOR_BGRA2BGR565",
    (True, 3): "COLOR_RGB2BGR565",
    (True, 4): "COLOR_RGBA2BGR565",
}


def _every_nth_pixel(image: Array, step: int) -> Array:
    """Every step-th pixel of every step-th row: (H/step,W/step,3),
    or (H/step,W/step) of four bytes, the last idle.
    """
    height = max(1, image.shape[0] // step)
    width = image.shape[1] // step
    if step == 1 or not image.flags.c_contiguous:
        return image[::step, ::step][:height, :width]
    # four bytes at a time is a third of the work; a further
    # pixel follows the last one taken, as step is above 1
    return np.ndarray(
        (height, width),
        np.uint32,
        image.data,
        0,
        (step * image.strides[0], step * image.strides[1]),
    )


def _copy_as_bgr(image: Array) -> Array:
    """A copy of an image's pixels in BGR, also where the image is a reversed view of RGB."""
    import cv2

    return (
        np.asarray(cv2.cvtColor(image[..., ::-1], cv2.COLOR_RGB2BGR))
        if _is_reversed_rgb(image)
        else image.copy()
    )


def _component_boxes(seen: Array) -> Iterator[tuple[int, tuple[int, int, int, int], bool]]:
    """The largest components of each mask (n,h,w), whose
    last rows are empty: mask; x, y, w, h; whether faint.
    """
    import cv2

    rows = seen.shape[1]
    found: dict[int, list[Array]] = {}
    for outline in cv2.findContours(
        seen.reshape(-1, seen.shape[2]), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )[0]:
        found.setdefault(int(outline[0, 0, 1]) // rows, []).append(outline)
    for which, outlines in found.items():
        largest = sorted(outlines, key=len, reverse=True)
        clear = sum(len(outline) >= _SMALL * len(largest[0]) for outline in largest[:CANDIDATES])
        for number, outline in enumerate(largest[: clear + FAINT]):
            x, y, w, h = cv2.boundingRect(outline)
            # single pixels are noise: the search is loose around a colour
            if number < clear or min(w, h) > 1:
                yield which, (x, y - which * rows, w, h), number >= clear

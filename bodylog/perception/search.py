"""Where each colour is in pictures: a search of every few pixels of many pictures at once; a window about each find."""

from collections.abc import Iterator, Sequence
from itertools import groupby
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


def windows(images: Sequence[Array], ranges: Sequence[Range]) -> list[Window]:
    """Windows about what may be each colour in images, each (H,W,3) BGR; at most CANDIDATES a picture and colour."""
    found: list[Window] = []
    for _, some in groupby(enumerate(images), key=lambda numbered: numbered[1].shape):
        numbers, alike = zip(*some, strict=True)
        found += [window._replace(picture=numbers[window.picture]) for window in _of_one_size(alike, ranges)]
    return found


def _of_one_size(images: Sequence[Array], ranges: Sequence[Range]) -> Iterator[Window]:
    import cv2

    height, width = images[0].shape[:2]
    step = max(1, round(width / _COARSE_WIDTH))
    hsv = cv2.cvtColor(_sheet(images, step), cv2.COLOR_BGR2HSV)
    rows = height // step + 1
    for index, colour in enumerate(ranges):
        seen = mask(hsv, colour)
        seen.reshape(len(images), rows, -1)[:, -1] = 0
        for picture, (x, y, w, h) in _boxes(seen, rows):
            left, top = max(0, (x - 1) * step - _MARGIN), max(0, (y - 1) * step - _MARGIN)
            part = images[picture][top : (y + h) * step + _MARGIN, left : (x + w) * step + _MARGIN]
            yield Window(picture, index, left, top, (width, height), part.copy())


def _sheet(images: Sequence[Array], step: int) -> Array:
    """Every step-th pixel of every step-th row of all pictures, one below the other with an empty row between."""
    height, width = images[0].shape[0] // step, images[0].shape[1] // step
    if step == 1:
        return np.concatenate([np.pad(image, ((0, 1), (0, 0), (0, 0))) for image in images])
    sheet = np.zeros((len(images), height + 1, width), np.uint32)
    for part, image in zip(sheet, images, strict=True):
        whole = np.ascontiguousarray(image)
        # four bytes at a time is a third of the work; the last pixel taken has another after it, as step is above 1
        strides = (step * whole.strides[0], step * whole.strides[1])
        part[:-1] = np.ndarray((height, width), np.uint32, whole.data, 0, strides)
    return sheet.view(np.uint8).reshape(-1, width, 4)


def _boxes(seen: Array, rows: int) -> Iterator[tuple[int, tuple[int, int, int, int]]]:
    """Picture and x, y, w, h (coarse px) of the components of a mask of pictures `rows` high, the largest of each."""
    import cv2

    outlines = cv2.findContours(seen, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    of_picture: dict[int, list[Array]] = {}
    for outline in outlines:
        of_picture.setdefault(int(outline[0, 0, 1]) // rows, []).append(outline)
    for picture, some in sorted(of_picture.items()):
        largest = sorted(some, key=len, reverse=True)[:CANDIDATES]
        for outline in largest:
            if len(outline) >= _FAINT * len(largest[0]):
                x, y, w, h = cv2.boundingRect(outline)
                yield picture, (x, y - picture * rows, w, h)

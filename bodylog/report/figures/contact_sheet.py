"""A contact sheet: a few images of a log with every
candidate outlined and numbered, and a line about each below.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...types import Array

_WIDTH = 480
_LINE = 22
_MARGIN = 10
_ARM = (80, 230, 80)
_OTHER = (190, 190, 190)


@dataclass(frozen=True, eq=False)
class Mark:
    """One candidate: caption, whether it is on the arm, its place in each image (n,2) px or NaN."""

    text: str
    arm: bool
    track: Array


def draw_contact_sheet(images: Mapping[int, Array], marks: Sequence[Mark]) -> Array:
    """The sheet (H,W,3) uint8 BGR of images {row of the tracks: (H,W,3)}."""
    tiles = [_draw_numbered_tile(image, number, marks) for number, image in sorted(images.items())]
    size = np.max([tile.shape for tile in tiles], axis=0)
    tiles = [_pad_to_size(tile, size) for tile in tiles]
    tiles += [np.zeros(size, np.uint8)] * (len(tiles) % 2)
    half = len(tiles) // 2
    pictures = (
        np.vstack([np.hstack(tiles[:half]), np.hstack(tiles[half:])])
        if half > 1
        else np.hstack(tiles)
    )
    return np.vstack([pictures, _draw_mark_legend(marks, pictures.shape[1])])


def _draw_numbered_tile(image: Array, number: int, marks: Sequence[Mark]) -> Array:
    """One image at the sheet's scale, with a numbered
    circle about each candidate; the arm's is drawn last.
    """
    import cv2

    scale = _WIDTH / image.shape[1]
    tile = np.ascontiguousarray(
        cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    )
    for index in sorted(range(len(marks)), key=lambda index: marks[index].arm):
        place = marks[index].track[number]
        if np.isfinite(place).all():
            u, v = np.rint(place * scale).astype(int).tolist()
            colour = _ARM if marks[index].arm else _OTHER
            cv2.circle(tile, (u, v), 14, (0, 0, 0), 3, cv2.LINE_AA)
            cv2.circle(tile, (u, v), 14, colour, 1 + marks[index].arm, cv2.LINE_AA)
            _write_caption(
                tile, str(index + 1), (min(u + 17, tile.shape[1] - 20), max(v, 12)), colour
            )
    return tile


def _draw_mark_legend(marks: Sequence[Mark], width: int) -> Array:
    strip = np.full((2 * _MARGIN + _LINE * max(1, len(marks)), width, 3), 24, np.uint8)
    for row, mark in enumerate(marks):
        text = f"{row + 1}  {mark.text}".encode("ascii", "replace").decode()
        _write_caption(
            strip, text, (_MARGIN, _MARGIN + _LINE * row + 15), _ARM if mark.arm else _OTHER
        )
    return strip


def _write_caption(
    image: Array, text: str, at: tuple[int, int], colour: tuple[int, int, int]
) -> None:
    import cv2

    size = (
        min(0.48, 0.48 * (image.shape[1] - at[0]) / max(1, 8.6 * len(text)))
        if len(text) > 3
        else 0.5
    )
    if len(text) <= 3:  # upon an image
        cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)


def _pad_to_size(image: Array, size: Array) -> Array:
    """The image in the upper left corner of a black one of that size (H,W,3)."""
    whole = np.zeros(size, np.uint8)
    whole[: image.shape[0], : image.shape[1]] = image
    return whole

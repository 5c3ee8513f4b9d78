"""Tag dictionaries as bit patterns in all four turns, and decoding of cells."""

import re
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ...types import Array


class Codes(NamedTuple):
    """One dictionary: patterns (K,4,n*n), true where white, by tag and turn · the same about 0 and
    of length 1 · n · number of wrong bits allowed."""

    patterns: Array
    units: Array
    side: int
    correctable: int


class DecodedCells(NamedTuple):
    """Decoded cells of M quads: tag, turn (M,) · score
    (M,) -1..1, their correlation · wrong (M,) bits.
    """

    tag: Array
    turn: Array
    score: Array
    wrong: Array


_OPENCV = {"mip_36h12": "ARUCO_MIP_36H12"}
_CORRECTED = 0.6
"""Share of the correctable bits that may be wrong: OpenCV's errorCorrectionRate."""


@lru_cache
def load_codes(dictionary: str) -> Codes:
    """The dictionary of that name."""
    import cv2

    known = cv2.aruco.getPredefinedDictionary(
        getattr(cv2.aruco, f"DICT_{_OPENCV.get(dictionary, dictionary).upper()}")
    )
    side = int(known.markerSize)
    bits = np.stack([known.getBitsFromByteList(row[None], side) for row in known.bytesList]).astype(
        np.float32
    )
    turned = np.stack([np.rot90(bits, turn, axes=(1, 2)) for turn in range(4)], axis=1)
    flat = turned.reshape(len(bits), 4, -1)
    apart = flat - flat.mean(axis=2, keepdims=True)
    units = apart / np.maximum(np.linalg.norm(apart, axis=2, keepdims=True), 1e-9)
    return Codes(
        flat > 0,
        units,
        side,
        int(_correctable_bits(dictionary, known.maxCorrectionBits) * _CORRECTED),
    )


def _correctable_bits(dictionary: str, stated: int) -> int:
    """Bits that could be corrected: of `36h11`, patterns
    11 bits apart, 5; OpenCV before 4.14 states 0 or 12.
    """
    apart = re.search(r"_\d+h(\d+)$", dictionary)
    return (int(apart[1]) - 1) // 2 if apart else stated


def decode_cells(cells: Array, known: Codes, only: Array | None = None) -> DecodedCells:
    """The tag most similar to cells (M,n*n) gray, and its
    turn; only tags `only` (T,) are considered where given.

    A turn of 1 means that the quad's first corner is the tag's second one.
    """
    patterns, units = (of if only is None else of[only] for of in (known.patterns, known.units))
    centred = (cells - cells.mean(axis=1, keepdims=True)).astype(np.float32)
    bits = cells.shape[1]
    scores = (
        centred
        @ units.reshape(-1, bits).T
        / np.maximum(np.linalg.norm(centred, axis=1), 1e-9)[:, None]
    )
    best = scores.argmax(axis=1)
    rows = np.arange(len(cells))
    tag = best // 4
    turn = best % 4
    wrong = _wrong_bits(cells, patterns.reshape(-1, bits)[best])
    return DecodedCells(tag if only is None else only[tag], turn, scores[rows, best], wrong)


def _wrong_bits(cells: Array, white: Array) -> Array:
    """Bits (M,) on the wrong side of the mean of black and white levels."""
    count = np.maximum(white.sum(axis=1), 1), np.maximum((~white).sum(axis=1), 1)
    middle = (
        np.where(white, cells, 0).sum(axis=1) / count[0]
        + np.where(white, 0, cells).sum(axis=1) / count[1]
    ) / 2
    return np.asarray(((cells > middle[:, None]) != white).sum(axis=1))

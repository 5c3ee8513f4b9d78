"""Counts and marker size of a ChArUco board, from the numbers and places of its markers in images.

Markers are numbered row by row over the white squares:
which numbers stand above one another tells the columns.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...types import Array
from . import quads, search

_FEWEST_MARKERS = 6
_MOST_COLUMNS = 32
_OFF_SQUARES = 0.1
"""Largest distance of a marker's corners from their places on the board, in sides of a square."""
_CLEARER = 0.5
"""Largest ratio of this distance and that of any other number of columns."""


class BoardShape(NamedTuple):
    """Columns and rows of squares, from the rows that
    were seen · marker: its side in sides of a square.
    """

    columns: int
    rows: int
    marker: float


def recognise_board(images: Sequence[search.Tags]) -> BoardShape | None:
    """The board whose markers are seen in some images, by
    tags of one dictionary; None where they are on none.
    """
    seen = [tags for tags in images if len(np.unique(tags.number)) >= _FEWEST_MARKERS]
    if not seen:
        return None
    last = max(int(tags.number.max()) for tags in seen)
    found = []
    for columns in range(2, _MOST_COLUMNS + 1):
        for parity in (1, 0):
            middles = _middles_of_markers(columns, parity, last + 1)
            fitted = [
                one for tags in seen if (one := _misfit_to_squares(middles, tags)) is not None
            ]
            if fitted:
                off = float(np.median([distance for distance, _ in fitted]))
                marker = float(np.median([side for _, side in fitted]))
                found.append((off, columns, parity, marker))
    found.sort()
    if not found or found[0][0] > _OFF_SQUARES:
        return None
    if len(found) > 1 and found[0][0] > _CLEARER * found[1][0]:
        return None
    _, columns, parity, marker = found[0]
    rows = int(_middles_of_markers(columns, parity, last + 1)[-1, 1] + 0.5)
    # where the first square is white, the number of rows is even
    rows += parity == 0 and rows % 2 == 1
    return BoardShape(columns, max(rows, 2), marker) if 0.0 < marker < 1.0 else None


def _middles_of_markers(columns: int, parity: int, count: int) -> Array:
    """Middles (count,2) of the first markers, in squares; parity: x + y of white ones, modulo 2."""
    rows = 2 * count // columns + 2
    white = [(x, y) for y in range(rows) for x in range(columns) if (x + y) % 2 == parity]
    return np.array(white[:count]) + 0.5


def _misfit_to_squares(middles: Array, tags: search.Tags) -> tuple[float, float] | None:
    """How far markers are from squares at their places
    (90th percentile), and their side, in sides of a square.

    None where no plane holds them.
    """
    import cv2

    plane = middles[tags.number]
    if np.linalg.matrix_rank(plane - plane[0], tol=1e-9) < 2:
        return None
    pose, _ = cv2.findHomography(tags.centres, plane, 0)
    if pose is None:
        return None
    corners = quads.apply_homographies(np.asarray(pose)[None], tags.quads.reshape(-1, 2))[
        0
    ].reshape(-1, 4, 2)
    square = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    about = corners - plane[:, None]
    # markers are squares along the board's sides: a sheared
    # board has places for all middles, but not for these
    side = float(
        np.median(about.reshape(len(plane), -1) @ square.ravel()) / np.square(square).sum()
    )
    away = np.linalg.norm(about - side * square, axis=2).max(axis=1)
    return float(np.percentile(away, 90)), side

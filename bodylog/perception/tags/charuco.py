"""ChArUco boards: the markers locate the board, then
the chessboard's corners are measured one by one.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ...sources import CharucoSource, board_points, track_names
from ...types import Array, Finding
from ..tracking.contract import HIDDEN, UNDECODABLE, Tracked, Tracker
from . import quads, search
from .board_shape import recognise_board
from .codes import decode_cells, load_codes
from .quads import sample_gray

_LEAST_MARKERS = 3
_MOST_OF = 0.5
_OFF = 3.0
_OFF_SIDE = 0.2
"""Largest distance of a marker's corner from its place
on a flat board without lens distortion: px, sides.
"""
_REACH = 0.7
"""Half a corner's window, as a share of the gap to the nearest marker."""
_SQUARE = 0.12
"""Distance from a corner at which its four squares are sampled, in sides of a square."""
_RELIEF = 0.4
"""Least share of the board's usual contrast between them."""
_KEPT = 0.7
"""Least share of the last frame's corners that must be found at their expected places."""
_REMEMBERED = 20
"""Images whose markers are kept, to tell another board by their numbers."""
_NEAR = 2.5
"""Squares: largest distance of a corner from a marker that was read."""
_HALF = 7
"""Samples on each side of a corner; they lie as far apart as its window is wide."""
_TURNS = 4
_FLOOR = 0.015
"""px: systematic error shared by all edges of a corner, as of a tag."""
_EXCESS = 2.0
"""Factor on the Cramér-Rao bound, from drawn boards."""


class Corners(NamedTuple):
    """uv (K,2) px, NaN where there is no corner within the window · cov (K,2,2) px²."""

    uv: Array
    cov: Array


class BoardLayout(NamedTuple):
    """A board: its inner corners (K,2) and its markers' (n,4,2), in squares.

    white (K,4): which of each corner's four squares, from top left clockwise, are white.
    """

    corners: Array
    markers: Array
    white: Array


class SeenBoard(NamedTuple):
    """A board in a frame: H (3,3) from squares to px ·
    corners (K,2) px, NaN where not seen · cov (K,2,2) px².
    """

    pose: Array
    uv: Array
    cov: Array


def charuco_trackers(features: Mapping[str, CharucoSource]) -> list[Tracker]:
    """One per board."""
    return [CharucoTracker(name, source) for name, source in features.items()]


def lay_out_board(source: CharucoSource, legacy: bool) -> BoardLayout:
    """Where corners and markers lie on a board."""
    columns, rows = source.shape
    corners = np.array(board_points(source))[:, :2] / source.square
    white = [
        (x, y)
        for y in range(rows)
        for x in range(columns)
        if (x + y) % 2 == (rows % 2 == 0 and legacy) ^ 1
    ]
    middle = np.array(white) + 0.5
    half = source.marker / source.square / 2
    square = half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    about = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    cells = np.floor(corners[:, None] + about).astype(int)
    known = set(white)
    around = [[tuple(cell) in known for cell in four] for four in cells.tolist()]
    return BoardLayout(corners, middle[:, None] + square, np.array(around))


class CharucoTracker:
    """Tracks one board."""

    def __init__(self, name: str, source: CharucoSource) -> None:
        """Load no library before the first frame."""
        self._name = name
        self._source = source
        # an odd number of rows begins and ends with a black square in both patterns
        same_pattern = source.shape[1] % 2 == 1
        kinds = (
            (False, True) if source.legacy is None and not same_pattern else (bool(source.legacy),)
        )
        self._layouts = {legacy: lay_out_board(source, legacy) for legacy in kinds}
        self._votes = dict.fromkeys(self._layouts, 0)
        self._frames: list[SeenBoard | None] = []
        self._broken: list[int] = []
        self._read = 0
        self._tags: list[search.Tags] = []

    def add(self, gray: Array | None) -> None:
        """The next frame (H,W) uint8; None: undecodable."""
        if gray is None:
            self._broken.append(len(self._frames))
        self._frames.append(None if gray is None else self._followed(gray) or self._anywhere(gray))

    def tracked(self) -> Tracked:
        """All corners that were ever seen."""
        names = track_names(self._name, self._source)
        values = np.full((len(self._frames), len(names), 4), np.nan)
        for row, seen in enumerate(self._frames):
            if seen is not None:
                values[row, :, :2] = seen.uv
                values[row, :, 2:] = np.sqrt(np.diagonal(seen.cov, axis1=1, axis2=2))
        values[np.isnan(values[..., 0])] = np.nan
        reasons = np.where(np.isfinite(values[..., 0]).any(axis=1), "", HIDDEN).astype(object)
        reasons[self._broken] = UNDECODABLE
        ever = np.isfinite(values[..., 0]).any(axis=0)
        ever = ever if ever.any() else np.arange(len(names)) == 0
        kept = tuple(name for name, there in zip(names, ever, strict=True) if there)
        return Tracked(kept, values[:, ever], reasons, self._findings(int(ever.sum()), len(names)))

    def _findings(self, seen: int, count: int) -> tuple[Finding, ...]:
        if any(self._votes.values()):
            pattern = f", legacy = {str(self._legacy()).lower()}" if len(self._layouts) > 1 else ""
            text = f"{self._name}: {seen} of the board's {count} corners seen{pattern}"
            return (Finding("info", text),)
        if self._read:
            found = recognise_board(self._tags)
            columns, rows = self._source.shape
            hint = (
                ""
                if found is None
                else f"; they are numbered as on a board of {found.columns} columns"
            )
            if found is not None and found.columns == rows:
                hint += f': type: charuco = "{rows}x{columns}"'
            elif found is not None:
                hint += (
                    f" and at least {found.rows} rows: type: charuco = "
                    f'"{found.columns}x{found.rows}"'
                )
            text = (
                f"{self._name}: {self._read} markers were read, but not as on a "
                f"{self._source.charuco} board{hint}"
            )
            return (Finding("warning", text),)
        return ()

    def _legacy(self) -> bool:
        return max(self._votes, key=lambda legacy: self._votes[legacy])

    def _layout(self) -> BoardLayout:
        return self._layouts[self._legacy()]

    def _anywhere(self, gray: Array) -> SeenBoard | None:
        """The board, from its markers in the whole image."""
        count = len(self._layout().markers)
        tags = search.search_whole_image(
            gray, load_codes(self._source.dictionary), np.arange(count)
        )
        self._read += len(tags.number)
        if len(self._tags) < _REMEMBERED:
            self._tags.append(tags)
        if len(tags.number) < _LEAST_MARKERS:
            return None
        poses = {
            legacy: _homography_of_markers(board, tags) for legacy, board in self._layouts.items()
        }
        for legacy, (_, count) in poses.items():
            self._votes[legacy] += count
        pose, _ = poses[self._legacy()]
        return None if pose is None else self._measured(gray, pose)

    def _followed(self, gray: Array) -> SeenBoard | None:
        """The board at its expected place, if most of its corners and its own markers are there."""
        expected = self._expected()
        if expected is None:
            return None
        seen = self._measured(gray, expected)
        before = self._frames[-1]
        if seen is None or before is None:
            return None
        count = np.isfinite(before.uv[:, 0]).sum()
        kept = np.isfinite(seen.uv[:, 0]).sum()
        return seen if kept >= _KEPT * count else None

    def _expected(self) -> Array | None:
        """H (3,3) of the next frame, by the corners' last motion."""
        last = self._frames[-1] if self._frames else None
        if last is None:
            return None
        before = self._frames[-2] if len(self._frames) > 1 else None
        moved = last.uv + (last.uv - before.uv if before is not None else 0.0)
        return _fit_homography(self._layout().corners, moved)

    def _measured(self, gray: Array, pose: Array) -> SeenBoard | None:
        """The board's corners near their places by H (3,3) from squares to px."""
        board = self._layout()
        gap = (1 - self._source.marker / self._source.square) / 2
        for _ in range(2):
            uv = quads.apply_homographies(pose[None], board.corners)[0]
            reach = np.clip(_REACH * gap * _side_of_square_px(pose, board.corners), 1.5, 6.0)
            found = refine_saddles(gray, uv, reach)
            found = _drop_corners_off_board(gray, pose, board, found)
            better = _fit_homography(board.corners, found.uv)
            if better is None:
                return None
            pose = better
        near = self._near_read(gray, pose, board)
        if near is None:
            return None
        return SeenBoard(pose, np.where(near[:, None], found.uv, np.nan), found.cov)

    def _near_read(self, gray: Array, pose: Array, board: BoardLayout) -> Array | None:
        """Corners (K,) bool near markers that read as their own; None where fewer than a few do."""
        known = load_codes(self._source.dictionary)
        places = quads.apply_homographies(pose[None], board.markers.reshape(-1, 2))[0].reshape(
            -1, 4, 2
        )
        bits, _ = quads.sample_cells(gray, places, known.side)
        there = np.flatnonzero(np.isfinite(bits).all(axis=1))
        if not there.size:
            return None
        seen = decode_cells(bits[there], known, np.arange(len(board.markers)))
        own = there[(seen.tag == there) & (seen.turn == 0) & (seen.wrong <= known.correctable)]
        if len(own) < _LEAST_MARKERS:
            return None
        middles = board.markers[own].mean(axis=1)
        away = np.linalg.norm(board.corners[:, None] - middles, axis=2).min(axis=1)
        return np.asarray(away <= _NEAR)


def _homography_of_markers(board: BoardLayout, tags: search.Tags) -> tuple[Array | None, int]:
    """H (3,3) from squares to px of most markers, and how many agree."""
    import cv2

    plane = board.markers[tags.number].reshape(-1, 2)
    image = tags.quads.reshape(-1, 2)
    side = float(np.median(np.linalg.norm(tags.quads[:, 0] - tags.quads[:, 1], axis=1)))
    pose, inside = cv2.findHomography(plane, image, cv2.RANSAC, max(_OFF, _OFF_SIDE * side))
    if pose is None:
        return None, 0
    count = int(inside.reshape(-1, 4).all(axis=1).sum())
    return (
        (np.asarray(pose), count)
        if count >= max(_LEAST_MARKERS, _MOST_OF * len(tags.number))
        else (None, 0)
    )


def _fit_homography(plane: Array, image: Array) -> Array | None:
    """H (3,3) by least squares through points (K,2) that are not NaN; None of fewer than 6."""
    import cv2

    there = np.isfinite(image).all(axis=1)
    if there.sum() < 6:
        return None
    pose, _ = cv2.findHomography(plane[there], image[there], cv2.RANSAC, _OFF)
    return None if pose is None else np.asarray(pose)


def _side_of_square_px(pose: Array, points: Array) -> Array:
    """The shortest side of a square, px, at points (K,2) of the plane: (K,)."""
    here, right, down = (
        quads.apply_homographies(pose[None], points + by)[0] for by in ((0, 0), (0.5, 0), (0, 0.5))
    )
    return np.asarray(
        2 * np.minimum(np.linalg.norm(right - here, axis=1), np.linalg.norm(down - here, axis=1))
    )


def _drop_corners_off_board(
    gray: Array, pose: Array, board: BoardLayout, found: Corners
) -> Corners:
    """Corners with white and black squares around them as on the board."""
    about = _SQUARE * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    expected = quads.apply_homographies(pose[None], board.corners)[0]
    points = quads.apply_homographies(pose[None], (board.corners[:, None] + about).reshape(-1, 2))[
        0
    ].reshape(-1, 4, 2)
    levels = quads.sample_gray(gray, points + np.nan_to_num(found.uv - expected)[:, None])
    light = np.where(board.white, levels, np.inf).min(axis=1)
    dark = np.where(board.white, -np.inf, levels).max(axis=1)
    relief = light - dark
    usual = np.nanmedian(np.where(relief > 0, relief, np.nan)) if (relief > 0).any() else np.inf
    return found._replace(uv=np.where((relief > _RELIEF * usual)[:, None], found.uv, np.nan))


def refine_saddles(gray: Array, uv: Array, reach: Array) -> Corners:
    """Corners near uv (K,2) px, each within a window of half its `reach` (K,) px to every side.

    Least squares: every gradient in the window is perpendicular
    to its line to the corner (Förstner & Gülch 1987).
    """
    place = uv.copy()
    cov = np.full((len(uv), 2, 2), np.nan)
    offsets = np.linspace(-1, 1, 2 * _HALF + 1)
    grid = np.stack(np.meshgrid(offsets, offsets), axis=-1)
    weight = np.exp(-(grid**2).sum(axis=2))[1:-1, 1:-1]
    for _ in range(_TURNS):
        step, cov = _step_to_saddle(gray, place, reach, grid, weight)
        place = place + np.clip(step, -reach[:, None], reach[:, None])
    far = np.linalg.norm(place - uv, axis=1) > reach
    return Corners(np.where(far[:, None], np.nan, place), cov)


def _step_to_saddle(
    gray: Array, place: Array, reach: Array, grid: Array, weight: Array
) -> tuple[Array, Array]:
    """The step from each place (K,2) px to the crossing of
    the gradients around it, and its covariance (K,2,2) px².
    """
    points = place[:, None, None] + reach[:, None, None, None] * grid
    levels = sample_gray(gray, points)
    spacing = (reach / _HALF)[:, None, None]
    gu = (levels[:, 1:-1, 2:] - levels[:, 1:-1, :-2]) / (2 * spacing)
    gv = (levels[:, 2:, 1:-1] - levels[:, :-2, 1:-1]) / (2 * spacing)
    gradient = np.stack([gu, gv], axis=-1).reshape(len(place), -1, 2)
    apart = (points[:, 1:-1, 1:-1] - place[:, None, None]).reshape(len(place), -1, 2)
    some = weight.ravel()[:, None, None]
    normal = (some * gradient[..., None] * gradient[..., None, :]).sum(axis=1)
    along = (gradient * apart).sum(axis=2)
    inverse = _invert_symmetric(normal)
    step = (inverse @ (some[..., 0] * gradient * along[..., None]).sum(axis=1)[..., None])[..., 0]
    # a perfect corner is symmetric under half a turn: the difference is noise
    noise = ((levels - levels[:, ::-1, ::-1]) ** 2).mean(axis=(1, 2)) / 2
    apart_px = np.minimum(reach / _HALF, 1.0) ** 2
    cov = (_EXCESS * noise / apart_px)[:, None, None] * inverse + _FLOOR**2 * np.eye(2)
    return np.nan_to_num(step, nan=np.inf, posinf=np.inf), cov


def _invert_symmetric(matrix: Array) -> Array:
    """Inverse of symmetric (K,2,2); NaN where one is singular."""
    a = matrix[:, 0, 0]
    b = matrix[:, 0, 1]
    c = matrix[:, 1, 1]
    det = a * c - b * b
    det = np.where(det > 1e-6 * (a + c) ** 2, det, np.nan)
    return (
        np.stack([np.stack([c, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=1)
        / det[:, None, None]
    )

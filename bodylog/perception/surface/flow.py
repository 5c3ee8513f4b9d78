"""Optical flow between frames, averaged over a grid of
cells: how the picture moves, wherever the arm may be.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from ...errors import InputError
from ...logs.datasets.checks import block_means
from ...types import Array, LazyImage
from .repeats import SHRINK, FrameRepeats, RepeatSearch, decode_grey, shrink_grey

FLOW_WIDTH_PX = 320
"""Width at which flow is computed: twice that changes
delays by less than their σ and costs four times as much.
"""
LEAST_SIDE_PX = 12
"""The shorter side of the smallest picture of which flow is computed: OpenCV refuses some below."""
PICTURES = 6
"""Pictures of a film that are kept for people."""
WHITE_GREY = 250
"""Grey level from which a pixel is saturated: white in video is 235 to 255."""
GRID_ROWS = 6
GRID_COLUMNS = 8
"""Cells of the grid: each is wider than the features
that flow needs, and narrower than a forearm.
"""


@dataclass(frozen=True, eq=False)
class GridFlow:
    """Flow of a camera between its distinct frames.

    times (N,2) s: stamps of the earlier and the later frame · flow (N,rows,columns,2) pixels at
    FLOW_WIDTH_PX, along u and v · brightness (M,) 99th percentile of each stored frame, grey levels
    · sharpness (M,) variance of its Laplacian, grey levels² · saturated (M,) share of its pixels
    that are white · block_change (M,) largest change of a block's mean against the frame before,
    grey levels, infinite of the first · pictures: a few frames (h,w) uint8, evenly spread ·
    repeats: which stored frames repeat their predecessor · size (width, height) px.
    """

    times: Array
    flow: Array
    brightness: Array
    sharpness: Array
    saturated: Array
    block_change: Array
    pictures: tuple[Array, ...]
    repeats: FrameRepeats
    size: tuple[int, int]


def measure_grid_flow(frames: Iterable[LazyImage]) -> GridFlow | None:
    """Decode frames once, find repeats, and measure
    flow between distinct ones; None without two frames.

    A frame may decode to a grey image (H,W) as well.

    Frames that cannot be decoded, and frames of another size than the first, are left out.
    """
    search = RepeatSearch()
    times: list[float] = []
    flows: list[Array] = []
    brightness: list[float] = []
    sharpness: list[float] = []
    saturated: list[float] = []
    block_change: list[float] = []
    pictures = _SpreadPictures()
    blocks: Array | None = None
    estimator = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
    before: Array | None = None
    size = (0, 0)
    for t, image in _decoded_grey_frames(frames):
        if not times:
            size = (image.shape[1], image.shape[0])
        elif (image.shape[1], image.shape[0]) != size:
            continue
        search.add(t, shrink_grey(image))
        small = _shrink_to_flow_width(image)
        if before is not None:
            flows.append(_cell_means(estimator, before, small))
        brightness.append(float(np.percentile(small, 99)))
        deviation = cv2.meanStdDev(cv2.Laplacian(small, cv2.CV_32F))[1]
        sharpness.append(float(deviation[0, 0]) ** 2)
        saturated.append(float(np.count_nonzero(small >= WHITE_GREY)) / small.size)
        earlier = blocks
        blocks = block_means(image)
        change = np.inf if earlier is None else np.abs(blocks - earlier).max()
        block_change.append(float(change))
        pictures.add(small)
        times.append(t)
        before = small
    if len(times) < 2:
        return None
    repeats = search.repeats()
    intervals = _distinct_intervals(repeats)
    return GridFlow(
        np.array(times)[intervals],
        np.array(flows)[intervals[:, 1] - 1],
        np.array(brightness),
        np.array(sharpness),
        np.array(saturated),
        np.array(block_change),
        pictures.chosen(),
        repeats,
        size,
    )


class _SpreadPictures:
    """Keeps pictures evenly spread over a film of unknown length: of many, every second one
    goes."""

    def __init__(self) -> None:
        self._every = 1
        self._count = 0
        self._pictures: list[Array] = []

    def add(self, picture: Array) -> None:
        """Take the next picture."""
        if self._count % self._every == 0:
            self._pictures.append(picture)
        if len(self._pictures) >= 2 * PICTURES:
            self._pictures = self._pictures[::2]
            self._every *= 2
        self._count += 1

    def chosen(self) -> tuple[Array, ...]:
        """At most PICTURES of them, from the first to the last."""
        numbers = np.linspace(0, len(self._pictures) - 1, min(PICTURES, len(self._pictures)))
        return tuple(self._pictures[number] for number in numbers.round().astype(int).tolist())


def _decoded_grey_frames(frames: Iterable[LazyImage]) -> Iterator[tuple[float, Array]]:
    """Yield time (s) and grey image (H,W) uint8 of each frame that can be decoded."""
    for frame in frames:
        try:
            yield frame.t, decode_grey(frame)
        except InputError:
            continue


def _shrink_to_flow_width(image: Array) -> Array:
    height, width = image.shape
    if width <= FLOW_WIDTH_PX:
        return image
    size = (FLOW_WIDTH_PX, max(round(height * FLOW_WIDTH_PX / width), SHRINK))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def _cell_means(estimator: Any, before: Array, after: Array) -> Array:
    """Mean flow in each cell (rows,columns,2) px; zero where the images are equal, or smaller than
    the estimator takes."""
    if min(before.shape) < LEAST_SIDE_PX or np.array_equal(before, after):
        return np.zeros((GRID_ROWS, GRID_COLUMNS, 2), np.float32)
    flow = estimator.calc(before, after, None)
    return np.asarray(cv2.resize(flow, (GRID_COLUMNS, GRID_ROWS), interpolation=cv2.INTER_AREA))


def _distinct_intervals(repeats: FrameRepeats) -> Array:
    """Indices (N,2) of stored frames: the first copy
    of each distinct frame and that of the next one.

    The flow into a distinct frame is measured from the last
    copy of its predecessor, which shows the same picture.
    """
    first_copies = np.flatnonzero(~repeats.repeated)
    return np.column_stack([first_copies[:-1], first_copies[1:]])

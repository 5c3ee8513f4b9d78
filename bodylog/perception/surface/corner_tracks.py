"""Corners of whatever moves, tracked in pieces of a few
seconds: pyramidal KLT with a check backwards in time.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

import cv2
import numpy as np

from ...errors import InputError
from ...types import Array, LazyImage
from .repeats import FrameRepeats, RepeatSearch, decode_grey, shrink_grey, shrunken_frames

LONGEST_FRAMES = 60
"""Frames after which a piece ends: templates age as the light on a link changes."""
SHORTEST_FRAMES = 12
"""Frames of the shortest piece that tells of a motion."""
LEAST_MOTION_PX = 6.0
"""Diagonal of the rectangle that a moving corner covers, at least."""
_DETECT_EVERY = 10
_MOST_ALIVE = 160
_CORNER_QUALITY = 0.01
_SPACING_PX = 7
_WINDOW_PX = 15
_PYRAMID_LEVELS = 3
_BACKWARD_PX = 0.4
"""Distance within which a corner tracked forwards and backwards returns."""
_MOVING_GREY = 10.0
"""Grey levels by which a pixel differs from the median picture where something moves."""
_DILATION = 5
_MOST_SAMPLES = 48
"""Shrunken images that make up the median picture."""
_STATIC_SHARE = 0.25
"""Share of corners that are taken where nothing moves: they tell whether the camera does."""
_SEED = 7
MOST_KEY_FRAMES = 80
"""Images of a film in which landmarks are looked for,
evenly spread: memory does not grow with the film.
"""
_MOST_KEPT_BYTES = 1 << 27
"""Grey images that are kept from one look at a film to the next; of a larger film none is."""


@dataclass(frozen=True, eq=False)
class CornerTracks:
    """Pieces of tracks: piece (R,) the number of each row's
    piece, ascending · frame (R,) index into t · uv (R,2) px.

    t (N,) s of the frames, repeats left out · size (width, height) px.
    """

    t: Array
    piece: Array
    frame: Array
    uv: Array
    size: tuple[int, int]

    @property
    def count(self) -> int:
        """The number of pieces."""
        return int(self.piece[-1]) + 1 if len(self.piece) else 0

    def take(self, pieces: Array) -> "CornerTracks":
        """The pieces with these numbers (K,), ascending, numbered from 0."""
        number = np.full(self.count, -1)
        number[pieces] = np.arange(len(pieces))
        rows = number[self.piece] >= 0
        return CornerTracks(
            self.t, number[self.piece[rows]], self.frame[rows], self.uv[rows], self.size
        )


@dataclass(frozen=True, eq=False)
class PictureSurvey:
    """A first look at a film: its repeats, and the median
    of its shrunken grey images (h,w), None without any.
    """

    repeats: FrameRepeats
    median: Array | None


@dataclass(frozen=True, eq=False)
class KeyFrames:
    """Some images of one log: t (F,) s, ascending, and the grey images (H,W) uint8."""

    t: Array
    images: tuple[Array, ...]


def survey_pictures(frames: Callable[[], Iterable[LazyImage]]) -> PictureSurvey:
    """Look at all frames once, shrunken; memory for images does not grow with the film."""
    search = RepeatSearch()
    samples = list[Array]()
    every = 1
    for n, (t, small) in enumerate(shrunken_frames(frames())):
        search.add(t, small)
        if n % every == 0 and (not samples or small.shape == samples[0].shape):
            samples.append(small)
        if len(samples) == 2 * _MOST_SAMPLES:
            samples = samples[::2]
            every = 2 * every
    median = np.median(samples, axis=0).astype(np.uint8) if samples else None
    return PictureSurvey(search.repeats(), median)


def track_corners(
    frames: Callable[[], Iterable[LazyImage]],
    most_pieces: int = 1200,
    most_key_frames: int = MOST_KEY_FRAMES,
) -> tuple[CornerTracks, PictureSurvey, KeyFrames]:
    """Track the corners of a camera's frames, which are read twice, or once if they are few.

    Of more than `most_pieces` pieces a fixed random choice is kept, so that memory does not grow
    with the film. Frames that repeat their predecessor, or cannot be decoded, are left out.
    """
    film = _KeptFilm(frames)
    survey = survey_pictures(film.first_look)
    fresh = survey.repeats.t[~survey.repeats.repeated]
    chosen = np.linspace(0, len(fresh) - 1, min(most_key_frames, len(fresh))).round().astype(int)
    is_key = dict.fromkeys(fresh.tolist(), False) | dict.fromkeys(fresh[chosen].tolist(), True)
    tracker = CornerTracker(survey.median, most_pieces)
    keys = list[tuple[float, Array]]()
    for t, image in film.second_look():
        if t in is_key:
            tracker.add(t, image)
            if is_key[t]:
                keys.append((t, image))
                is_key[t] = False
    key_frames = KeyFrames(np.array([t for t, _ in keys]), tuple(image for _, image in keys))
    return tracker.tracks(), survey, key_frames


class _KeptFilm:
    """A film that is looked at twice. Where a shrunken image costs as much to decode as a whole
    one, the first look keeps the grey images if all fit in _MOST_KEPT_BYTES.
    """

    def __init__(self, frames: Callable[[], Iterable[LazyImage]]) -> None:
        self._frames = frames
        self._kept: list[tuple[float, Array]] = []
        self._whole = True
        self._size = 0

    def first_look(self) -> Iterator[LazyImage]:
        """The frames, which are kept as they are decoded."""
        for frame in self._frames():
            if frame.shrinks:
                self._give_up()
                yield frame
            else:
                yield replace(frame, decode=partial(self._decode, frame))

    def second_look(self) -> Iterator[tuple[float, Array]]:
        """Time (s) and grey image (H,W) uint8 of each frame that can be decoded."""
        if self._whole:
            yield from self._kept
            return
        for frame in self._frames():
            with suppress(InputError):
                yield frame.t, decode_grey(frame)

    def _decode(self, frame: LazyImage, _shrink: int) -> Array:
        image = decode_grey(frame)
        self._size += image.nbytes
        if self._size > _MOST_KEPT_BYTES:
            self._give_up()
        if self._whole:
            self._kept.append((frame.t, image))
        return image

    def _give_up(self) -> None:
        self._whole = False
        self._kept.clear()


@dataclass(eq=False)
class _CornerPiece:
    """A corner that is being tracked."""

    frames: list[int] = field(default_factory=list)
    places: list[tuple[float, float]] = field(default_factory=list)


class CornerTracker:
    """Tracks corners through grey images, given one by one."""

    def __init__(self, median: Array | None, most_pieces: int = 1200) -> None:
        """Median: the scene's shrunken picture (h,w); corners
        are looked for where an image differs from it.
        """
        self._median = median
        self._most = most_pieces
        self._t: list[float] = []
        self._image: Array | None = None
        self._alive: list[_CornerPiece] = []
        self._kept: list[tuple[float, _CornerPiece]] = []
        self._random = np.random.default_rng(_SEED)
        self._least_rank = 1.0

    def add(self, t: float, image: Array) -> None:
        """Take the next image (H,W) uint8, at t s."""
        number = len(self._t)
        self._t.append(t)
        if self._image is not None and self._image.shape == image.shape:
            self._follow(image, number)
        else:
            self._end(self._alive)
            self._alive = []
        if number % _DETECT_EVERY == 0:
            self._detect(image, number)
        self._image = image

    def tracks(self) -> CornerTracks:
        """End all pieces and return them, by the time of their first frame."""
        self._end(self._alive)
        self._alive = []
        self._thin()
        pieces = [piece for _, piece in self._kept]
        pieces.sort(key=lambda piece: (piece.frames[0], piece.places[0]))
        height, width = (0, 0) if self._image is None else self._image.shape
        piece = np.repeat(np.arange(len(pieces)), [len(one.frames) for one in pieces])
        frame = np.array([n for one in pieces for n in one.frames], np.int64)
        uv = np.array([place for one in pieces for place in one.places], float).reshape(-1, 2)
        return CornerTracks(np.array(self._t), piece, frame, uv, (width, height))

    def _follow(self, image: Array, number: int) -> None:
        if not self._alive:
            return
        assert self._image is not None
        before = np.array([piece.places[-1] for piece in self._alive], np.float32)
        after, found = _flow_of_corners(self._image, image, before)
        back, found_back = _flow_of_corners(image, self._image, after)
        height, width = image.shape
        inside = (after > 0).all(axis=1) & (after[:, 0] < width - 1) & (after[:, 1] < height - 1)
        close = np.linalg.norm(back - before, axis=1) <= _BACKWARD_PX
        sound = found & found_back & inside & close
        alive = list[_CornerPiece]()
        ended = list[_CornerPiece]()
        for piece, place, good in zip(self._alive, after.tolist(), sound.tolist(), strict=True):
            if good:
                piece.frames.append(number)
                piece.places.append((place[0], place[1]))
            (alive if good and len(piece.frames) < LONGEST_FRAMES else ended).append(piece)
        self._alive = alive
        self._end(ended)

    def _detect(self, image: Array, number: int) -> None:
        free = np.full(image.shape, 255, np.uint8)
        for piece in self._alive:
            u, v = piece.places[-1]
            cv2.circle(free, (round(u), round(v)), _SPACING_PX, 0, -1)
        moving = self._moving(image)
        room = _MOST_ALIVE - len(self._alive)
        still = int(_STATIC_SHARE * room) if moving is not None else 0
        masks = [(free if moving is None else cv2.bitwise_and(free, moving), room - still)]
        if moving is not None:
            masks.append((cv2.bitwise_and(free, cv2.bitwise_not(moving)), still))
        for mask, most in masks:
            if most < 1:
                continue
            corners = cv2.goodFeaturesToTrack(image, most, _CORNER_QUALITY, _SPACING_PX, mask=mask)
            if corners is None:
                continue
            refined = corners.reshape(-1, 2)
            self._alive += [_CornerPiece([number], [(float(u), float(v))]) for u, v in refined]

    def _moving(self, image: Array) -> Array | None:
        """Where an image differs from the median picture
        (H,W) 0 or 255; None without one to compare.
        """
        small = shrink_grey(image)
        if self._median is None or self._median.shape != small.shape:
            return None
        differs = (cv2.absdiff(small, self._median) > _MOVING_GREY).astype(np.uint8) * 255
        grown = cv2.dilate(differs, np.ones((_DILATION, _DILATION), np.uint8))
        height, width = image.shape
        return np.asarray(cv2.resize(grown, (width, height), interpolation=cv2.INTER_NEAREST))

    def _end(self, pieces: Iterable[_CornerPiece]) -> None:
        for piece in pieces:
            rank = float(self._random.random())
            if len(piece.frames) >= SHORTEST_FRAMES and rank < self._least_rank:
                self._kept.append((rank, piece))
        if len(self._kept) > 2 * self._most:
            self._thin()

    def _thin(self) -> None:
        """Keep the pieces of least rank: a uniform choice of all."""
        if len(self._kept) > self._most:
            self._kept.sort(key=lambda ranked: ranked[0])
            del self._kept[self._most :]
            self._least_rank = self._kept[-1][0]


def _flow_of_corners(image: Array, other: Array, places: Array) -> tuple[Array, Array]:
    """Where places (n,2) px of an image are in another, and whether they were found (n,)."""
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        image,
        other,
        places,
        places.copy(),
        winSize=(_WINDOW_PX, _WINDOW_PX),
        maxLevel=_PYRAMID_LEVELS,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01),
    )
    return np.asarray(moved), np.asarray(found)[:, 0] > 0


def moving_pieces(tracks: CornerTracks, least_px: float = LEAST_MOTION_PX) -> Array:
    """Numbers of the pieces that cover at least a rectangle of this diagonal, px."""
    return np.array(
        [
            k
            for k, uv in enumerate(places_by_piece(tracks))
            if np.linalg.norm(np.ptp(uv, axis=0)) >= least_px
        ],
        int,
    )


def places_by_piece(tracks: CornerTracks) -> Iterator[Array]:
    """Yield each piece's places (n,2) px."""
    bounds = np.searchsorted(tracks.piece, np.arange(tracks.count + 1))
    for begin, end in pairwise(bounds):
        yield tracks.uv[begin:end]

"""Frames that repeat their predecessor: a recorder
that is faster than its camera stores images twice.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from ...errors import InputError
from ...types import Array, LazyImage
from ..colours.coarse_search import convert_to_gray

SHRINK = 4
"""Images are compared at this fraction of their size."""
_WINDOW_PX = 5
"""Side, in shrunken pixels, of the window over which
differences are averaged: a moving thing, not noise.
"""
_BUSY_PERCENT = 99.0
"""Percentile of the windows' differences that stands for an image: a small moving part counts."""
_REPEAT_SHARE = 0.3
"""Largest change of a repeat, as a share of the lesser
change beside it, both above the noise of coding.
"""
_LEAST_MOTION_GREY = 1.5
"""Grey levels above the noise that the images
beside a repeat change at least; less is no motion.
"""
_MOST_NOISE_GREY = 3.0
"""Grey levels that coding changes in a still scene,
at most: 0.7 to 2.2 in real films. More is motion.
"""
_REVERSAL_SHARE = 0.75
"""Changes that fall to this share towards an instant from
both sides: a motion that stops or reverses, no repeat.
"""
_LONG_BEAT = 4
"""Frames from one new image to the next, from which the frames beside a repeat do not tell it."""
_LEAST_BEATS = 5
_STEADY_SHARE = 0.75
"""New images that come after the same number of frames, one more or one less, of those that no
pause of two such beats and more lies before: fewer tell no beat."""
_LEAST_JUDGED = 20
"""Moving frames that suffice for a share; with fewer,
frames that are equal in every pixel count as well.
"""


@dataclass(frozen=True, eq=False)
class FrameRepeats:
    """Which frames of a camera repeat the one before.

    t (N,) s · repeated (N,) · judged (N,): frames for which the images can tell, those in which
    something moves · change (N,) grey levels against the frame before, NaN of the first, where most
    changes · noise (N,) the same of the median place: of a camera at rest the noise of its sensor.
    """

    t: Array
    repeated: Array
    judged: Array
    change: Array
    noise: Array

    @property
    def share(self) -> float | None:
        """Share of repeats among the judged frames; None without any."""
        count = int(self.judged.sum())
        return float(self.repeated[self.judged].sum() / count) if count else None

    @property
    def stored_hz(self) -> float | None:
        """Rate of all frames, Hz; None of fewer than two."""
        gaps = np.diff(self.t)
        return float(1.0 / np.median(gaps)) if len(gaps) and np.median(gaps) > 0 else None

    @property
    def distinct_hz(self) -> float | None:
        """Rate of distinct frames, Hz: that of all, less the share of repeats."""
        if self.stored_hz is None:
            return None
        return self.stored_hz * (1.0 - (self.share or 0.0))


class RepeatSearch:
    """Compares each frame with the one before; memory is four numbers a frame."""

    def __init__(self) -> None:
        """Start before the first frame."""
        self._before: Array | None = None
        self._t: list[float] = []
        self._change: list[float] = []
        self._noise: list[float] = []
        self._equal: list[bool] = []

    def add(self, t: float, small: Array) -> None:
        """Take the next frame at t (s) as a shrunken grey
        image (h,w) uint8; its shape must not change.
        """
        change = float("nan")
        noise = float("nan")
        equal = False
        if self._before is not None and self._before.shape == small.shape:
            difference = cv2.absdiff(small, self._before)
            equal = not difference.any()
            windows = cv2.blur(difference.astype(np.float32), (_WINDOW_PX, _WINDOW_PX))
            rank = int(windows.size * _BUSY_PERCENT / 100.0)
            middle = windows.size // 2
            ordered = np.partition(windows.ravel(), (middle, rank))
            change = float(ordered[rank])
            noise = float(ordered[middle])
        self._t.append(t)
        self._noise.append(noise)
        self._change.append(change)
        self._equal.append(equal)
        self._before = small

    def repeats(self) -> FrameRepeats:
        """Judge the frames so far."""
        change = np.array(self._change)
        equal = np.array(self._equal, bool)
        repeated, judged = _judge_repeats(change, equal)
        return FrameRepeats(np.array(self._t), repeated, judged, change, np.array(self._noise))


def shrunken_frames(frames: Iterable[LazyImage]) -> Iterator[tuple[float, Array]]:
    """Yield time (s) and shrunken grey image (h,w) uint8 of each frame that can be decoded."""
    for frame in frames:
        try:
            yield frame.t, shrink_frame(frame)
        except InputError:
            continue


def shrink_frame(frame: LazyImage) -> Array:
    """A frame in grey, shrunken by means of pixels,
    (h,w) uint8. InputError where it cannot be decoded.
    """
    if frame.shrinks:
        return convert_to_gray(frame.decode(SHRINK))
    return shrink_grey(decode_grey(frame))


def decode_grey(frame: LazyImage) -> Array:
    """A frame as a grey image (H,W) uint8; it may decode to one. InputError where it cannot be
    decoded.
    """
    image = frame.decode(1)
    return image if image.ndim == 2 else convert_to_gray(image)


def shrink_grey(image: Array) -> Array:
    """A grey image (H,W) uint8 as means of SHRINK by SHRINK pixels, (h,w) uint8."""
    height, width = image.shape
    size = (max(width // SHRINK, 1), max(height // SHRINK, 1))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def _judge_repeats(change: Array, equal: Array) -> tuple[Array, Array]:
    """Which frames repeat their predecessor, and for which that can be decided, both (N,)."""
    finite = change[np.isfinite(change) & ~equal]
    noise = min(float(np.percentile(finite, 5.0)), _MOST_NOISE_GREY) if len(finite) else 0.0
    motion = np.where(np.isfinite(change) & ~equal, np.maximum(change - noise, 0.0), 0.0)
    first = ~np.isfinite(change)
    before, slows = _motion_before_frames(motion)
    after, quickens = (part[::-1] for part in _motion_before_frames(motion[::-1]))
    beside = np.minimum(before, after)
    between_motion = (
        (beside >= _LEAST_MOTION_GREY)
        & (motion <= _REPEAT_SHARE * beside)
        & ~(slows & quickens)
        & ~first
    )
    between_motion |= _long_copies(motion) & ~first
    repeated = (equal & ~first) | between_motion
    moving = between_motion | (motion >= _LEAST_MOTION_GREY)
    judged = moving if moving.sum() >= _LEAST_JUDGED else moving | repeated
    return repeated, judged


def _long_copies(motion: Array) -> Array:
    """Frames (N,) between new ones, where nearly all images are stored the same number of times,
    more often than three: a film of a single pause has no such beat."""
    found = np.zeros(len(motion), bool)
    new = np.flatnonzero(motion >= _LEAST_MOTION_GREY)
    gaps = np.diff(new)
    if len(gaps) < _LEAST_BEATS:
        return found
    beat = float(np.median(gaps))
    steady = np.abs(gaps - beat) <= 1.0
    of_motion = steady[gaps < 2.0 * beat]
    if beat < _LONG_BEAT or len(of_motion) < _LEAST_BEATS or of_motion.mean() < _STEADY_SHARE:
        return found
    for begin, end in zip(new[:-1][steady].tolist(), new[1:][steady].tolist(), strict=True):
        least = _REPEAT_SHARE * min(motion[begin], motion[end])
        found[begin + 1 : end] = motion[begin + 1 : end] <= least
    return found


def _motion_before_frames(motion: Array) -> tuple[Array, Array]:
    """The greater motion of the two frames before each, and
    whether the motion was falling before it, both (N,).
    """
    padded = np.pad(motion, (4, 0))
    last = np.arange(len(motion)) + 3
    greater = np.maximum(padded[last], padded[last - 1])
    # of a frame stored three times the second copy has the first beside it
    last = np.where(padded[last] > _REPEAT_SHARE * greater, last, last - 1)
    earlier = np.maximum(padded[last - 1], padded[np.maximum(last - 2, 0)])
    return greater, padded[last] <= _REVERSAL_SHARE * earlier

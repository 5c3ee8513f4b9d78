"""A video file beside the log as a camera."""

from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...errors import LogError
from ..limits import LIMITS, Input
from ..records import Array, Frame
from .mp4_boxes import check_samples

_DATES = 1e8
"""s: larger times count from 1970, smaller ones from a start that the table does not give."""


class Sidecar(NamedTuple):
    """A video: its file, frames per second, declared number of frames, and their times t (K,) s from a table."""

    path: Path
    rate: float
    frames: int
    t: Array | None = None


def find(name: str, log: Path, rate: float | None, limits: Input = LIMITS) -> Sidecar:
    """Find the video `name`, here or beside the log, at `rate` (1/s; None: its own).

    LogError if it is missing, or its images are too large or too many.
    """
    path = next((p for p in (Path(name), log.parent / name) if p.is_file()), None)
    if path is None:
        raise LogError(f"{log}: [topics] camera = {name!r}, but there is no such file, here or beside the log")
    check_samples(path, limits)
    capture = _open(path)
    own, length = capture.get(_property("FPS")), int(capture.get(_property("FRAME_COUNT")))
    width, height = (capture.get(_property(f"FRAME_{side}")) for side in ("WIDTH", "HEIGHT"))
    capture.release()
    if width * height > limits.max_image_mpx * 1e6:
        text = f"{path}: images of {width:.0f} x {height:.0f}"
        raise LogError(f"{text}; set [input] max_image_mpx to read larger ones")
    if length > limits.max_frames:
        asked = f"type in robot.toml: [input] max_frames = {length}"
        raise LogError(f"{path}: {length} images; to read them, {asked}")
    if not 0 < (rate or own) < 1e6:
        raise LogError(
            f"{path}: the video declares {rate or own} frames per second; type in robot.toml: [topics] rate = 30"
        )
    return Sidecar(path, rate or own, max(length, 0), _times(path, length) if rate is None else None)


def _times(path: Path, frames: int) -> Array | None:
    """The times of a video's frames from a table beside it; LogError if it has another number of rows."""
    from ..datasets.tables import table_beside, times_beside

    t = times_beside(path)
    if t is not None and len(t) != frames:
        text = f"{len(t)} rows for the {frames} frames of {path.name}; rename it, or type: [topics] rate"
        raise LogError(f"{table_beside(path)}: {text}")
    return t


def frames(
    video: Sidecar, first_s: float | None, start_ns: int, limits: Input = LIMITS
) -> Callable[[], Iterator[Frame]]:
    """A function that decodes the video from its beginning; its first frame is at first_s after start_ns.

    Raises LogError at an image that is larger, or one more, than the limits allow: a file may declare fewer, or grow.
    If a table has the frames' times counted from 1970, first_s None keeps these times.
    """
    at = _at(video, first_s, start_ns)

    def read() -> Iterator[Frame]:
        capture = _open(video.path)
        try:
            for number in count():
                there, image = capture.read()
                if not there:
                    return
                _check_image(video.path, number, image, limits)
                t = at(number)
                yield Frame(t, start_ns + round(t * 1e9), _decode(image))
        finally:
            capture.release()

    return read


def _at(video: Sidecar, first_s: float | None, start_ns: int) -> Callable[[int], float]:
    """A function from a frame's number to its time, s after start_ns; after the table, the video's rate gives it."""
    if video.t is None or not len(video.t):
        return lambda number: (first_s or 0.0) + number / video.rate
    is_date = first_s is None and float(video.t[0]) >= _DATES
    t = (video.t - start_ns / 1e9 if is_date else video.t - video.t[0] + (first_s or 0.0)).tolist()
    return lambda number: t[number] if number < len(t) else t[-1] + (number + 1 - len(t)) / video.rate


def _check_image(path: Path, number: int, image: Array, limits: Input) -> None:
    """LogError where an image is one too many, or has more pixels than the file declared and than are allowed."""
    height, width = image.shape[:2]
    if width * height > limits.max_image_mpx * 1e6:
        text = f"{path}: image {number} has {width} x {height} px, more than the file declared"
        raise LogError(f"{text}; set [input] max_image_mpx to read larger ones")
    if number >= limits.max_frames:
        asked = f"type in robot.toml: [input] max_frames = {10 * limits.max_frames}"
        raise LogError(f"{path}: more than {limits.max_frames} images; to read them, {asked}")


def _decode(image: Array) -> Callable[[int], Array]:
    return lambda k: np.ascontiguousarray(image[::k, ::k])


def _open(path: Path) -> Any:
    import cv2

    capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        raise LogError(f"{path}: cannot be opened as a video")
    return capture


def _property(name: str) -> int:
    import cv2

    return int(getattr(cv2, f"CAP_PROP_{name}"))

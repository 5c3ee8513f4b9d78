"""A video file beside the log as a camera."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...errors import FormatError, LogError
from ..datasets import video
from ..limits import LIMITS, Input
from ..records import Array, LazyImage

_DATES = 1e8
"""s: larger times count from 1970, smaller ones from a start that the table does not give."""


class Sidecar(NamedTuple):
    """A video, and the times t (K,) s of its frames, from a table beside it where it has one."""

    video: video.Video
    t: Array

    @property
    def largest_gap(self) -> float:
        """The longest time (s) without an image."""
        return float(np.diff(self.t).max()) if len(self.t) > 1 else 0.0


def find_video_file(name: str, log: Path, rate: float | None, limits: Input = LIMITS) -> Sidecar:
    """Find the video `name`, here or beside the log, at `rate` (1/s; None: its own times).

    LogError if it is missing or no video, or its images are too large or too many.
    """
    path = next((p for p in (Path(name), log.parent / name) if p.is_file()), None)
    if path is None:
        asked = f"[topics] camera = {name!r}, but there is no such file, here or beside the log"
        raise LogError(f"{log}: {asked}")
    film = video.survey_video(path, limits)
    if rate is not None:
        return Sidecar(film, np.arange(len(film.pts)) / rate)
    t = _read_frame_times(film)
    return Sidecar(film, film.t - film.t[:1] if t is None else t)


def _read_frame_times(film: video.Video) -> Array | None:
    """The times of a video's frames from a table beside it; LogError if it has another number of
    rows.
    """
    from ..datasets.tables import table_beside, times_beside

    t = times_beside(film.path)
    if t is not None and len(t) != len(film.pts):
        rows = f"{len(t)} rows for the {len(film.pts)} frames of {film.path.name}"
        cure = "rename it, or type: [topics] rate"
        raise LogError(f"{table_beside(film.path)}: {rows}; {cure}")
    return t


def make_video_decoder(
    side: Sidecar, first_s: float | None, start_ns: int
) -> Callable[[], Iterator[LazyImage]]:
    """A function that decodes the video from its beginning; its first frame is at first_s after
    start_ns.

    If a table has the frames' times counted from 1970, first_s None keeps these times. What the
    file gained since it was found is left out, and an image of another size cannot be decoded.
    """
    is_date = first_s is None and len(side.t) > 0 and float(side.t[0]) >= _DATES
    begins = start_ns / 1e9 if is_date else side.t[:1] - (first_s or 0.0)
    times = (side.t - begins).tolist()

    def read() -> Iterator[LazyImage]:
        for number, image in video.iterate_video_images(side.video):
            t = times[number]
            yield LazyImage(
                t, start_ns + round(t * 1e9), _decode_video_frame(side.video.path, number, image)
            )

    return read


def _decode_video_frame(path: Path, number: int, image: Array | None) -> Callable[[int], Array]:
    def decode(k: int) -> Array:
        if image is None:
            raise FormatError(f"{path.name}: image {number} is damaged or of another size")
        return np.ascontiguousarray(image[::k, ::k])

    return decode

"""A video file beside the log as camera."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import LogError
from ..settings import Topics
from ..types import Array, Frame


@dataclass(frozen=True)
class Sidecar:
    """A video's file, frames per second, and how many frames it says it has."""

    path: Path
    rate: float
    frames: int


def find(name: str, log: Path, settings: Topics) -> Sidecar:
    """The video `name`, looked for as it is and beside the log; LogError when there is none or it has no rate."""
    path = next((p for p in (Path(name), log.parent / name) if p.is_file()), None)
    if path is None:
        raise LogError(f"{log}: [topics] camera = {name!r}, but there is no such file, here or beside the log")
    capture = _open(path)
    rate, length = settings.rate or capture.get(_property("FPS")), int(capture.get(_property("FRAME_COUNT")))
    capture.release()
    if not 0 < rate < 1e6:
        raise LogError(f"{path}: the video says {rate} frames per second; say in robot.toml: [topics] rate = 30")
    return Sidecar(path, rate, max(length, 0))


def frames(video: Sidecar, first_s: float, start_ns: int) -> Callable[[], Iterator[Frame]]:
    """A function that decodes the video from its beginning; its first frame is at first_s after start_ns."""

    def read() -> Iterator[Frame]:
        capture = _open(video.path)
        try:
            for number in count():
                there, image = capture.read()
                if not there:
                    return
                t = first_s + number / video.rate
                yield Frame(t, start_ns + round(t * 1e9), _decode(image))
        finally:
            capture.release()

    return read


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

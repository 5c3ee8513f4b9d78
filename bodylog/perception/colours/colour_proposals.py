"""Colours that some images of a log offer: the peaks of their hue histogram."""

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from ...errors import FormatError
from ...types import Array, Recording
from .hsv_ranges import SATURATION, VALUE, HsvRange, hue_histogram, nearest_hue_name, range_between

_LOOKED_AT = 120
_WIDTH = 9
_SHARE = 2e-4


def pick_images(recording: Recording) -> Callable[[], Iterator[tuple[float, Array]]]:
    """Times and images, at most _LOOKED_AT evenly spaced,
    decoded one by one; undecodable ones are left out.
    """
    frames = recording.cameras.frames or (lambda: iter(()))
    every = -(-sum(1 for _ in frames()) // _LOOKED_AT)

    def pictures() -> Iterator[tuple[float, Array]]:
        for frame in (frame for index, frame in enumerate(frames()) if index % every == 0):
            try:
                image = frame.decode(1)
            except FormatError:
                continue
            yield frame.t, image

    return pictures


def why_none(recording: Recording) -> str:
    """Why there are no images: the log has none, or the first cannot be decoded."""
    for frame in recording.cameras.frames() if recording.cameras.frames else ():
        try:
            frame.decode(1)
        except FormatError as problem:
            return f"no picture can be decoded: {problem}"
    return "no pictures to look for features in"


def find_hue_peaks(images: Iterable[Array]) -> list[int]:
    """The peaks of the pictures' hue histogram over saturated
    pixels, each holding a notable share of all pixels.
    """
    counts = np.zeros(180)
    pixels = 0
    for image in images:
        some, of = hue_histogram(image)
        counts = counts + some
        pixels = pixels + of
    smooth = np.convolve(
        np.concatenate([counts[-_WIDTH:], counts, counts[:_WIDTH]]),
        np.ones(2 * _WIDTH + 1),
        "valid",
    )
    found: list[int] = []
    for hue in np.argsort(-smooth, kind="stable").tolist():
        apart = all(abs((hue - other + 90) % 180 - 90) > 2 * _WIDTH for other in found)
        if apart and smooth[hue] >= _SHARE * pixels:
            found.append(hue)
    return found


def range_around_hue(hue: int) -> HsvRange:
    """The range about a hue 0..179."""
    return range_between(
        ((hue - _WIDTH) % 180, SATURATION, VALUE), ((hue + _WIDTH) % 180, 255, 255)
    )


def name_of_middle_hue(colour: HsvRange) -> str:
    """The name of a range's middle hue."""
    low = colour.parts[0][0]
    high = colour.parts[-1][1]
    return nearest_hue_name((low[0] + ((high[0] - low[0]) % 180) / 2) % 180)

"""Colour names as ranges of OpenCV's HSV (h 0..179, s and v 0..255)."""

from dataclasses import dataclass

import numpy as np

from ...errors import ConfigError
from ...settings import Colour
from ...types import Array

_NAMED: dict[str, tuple[int, int]] = {
    "red": (170, 9),
    "orange": (8, 22),
    "yellow": (20, 36),
    "green": (37, 85),
    "cyan": (80, 100),
    "blue": (98, 132),
    "magenta": (133, 172),
}
SATURATION = 90
VALUE = 50
"""Least saturation and value of a coloured pixel."""

Bound = tuple[int, int, int]


@dataclass(frozen=True)
class HsvRange:
    """A colour's range: one box of HSV (low, high), or
    two where the hue wraps around; both ends included.
    """

    parts: tuple[tuple[Bound, Bound], ...]


def range_between(low: Bound, high: Bound) -> HsvRange:
    """The range from low to high, across hue 179 where the low hue is above the high hue."""
    if low[0] <= high[0]:
        return HsvRange(((low, high),))
    return HsvRange(((low, (180, high[1], high[2])), ((0, low[1], low[2]), high)))


def resolve_colour(colour: Colour, key: str) -> HsvRange:
    """The HSV range of a setting `key`; raises ConfigError
    for a name not in the table or bounds out of range.
    """
    if isinstance(colour, str):
        return _range_by_name(colour, key)
    try:
        bounds = np.array([colour["low"], colour["high"]], dtype=np.int64)
    except (KeyError, TypeError, ValueError):
        bounds = np.zeros(0, dtype=np.int64)
    if bounds.shape != (2, 3) or (bounds < 0).any() or (bounds > (180, 255, 255)).any():
        raise ConfigError(
            f"colours.{key}: found {dict(colour)}; possible: low = [h, s, v] and high = [h, "
            "s, v] with h 0..180, "
            f"s and v 0..255; type: {key} = {{low = [37, 90, 50], high = [85, 255, 255]}}"
        )
    low, high = bounds.tolist()
    return range_between((low[0], low[1], low[2]), (high[0], high[1], high[2]))


def mask_of_range(hsv: Array, colour: HsvRange) -> Array:
    """255 where hsv (H,W,3) lies in the range, else 0: (H,W) uint8."""
    import cv2

    seen = cv2.inRange(hsv, *colour.parts[0])
    for low, high in colour.parts[1:]:
        cv2.bitwise_or(seen, cv2.inRange(hsv, low, high), seen)
    return np.asarray(seen)


def hue_histogram(image: Array) -> tuple[Array, int]:
    """The hue histogram (180,) of an image's saturated
    pixels, one in 16, and the number of pixels counted.
    """
    import cv2

    hsv = cv2.cvtColor(np.ascontiguousarray(image[::4, ::4]), cv2.COLOR_BGR2HSV)
    hue, saturation, value = np.moveaxis(hsv, -1, 0)
    return np.bincount(hue[(saturation >= SATURATION) & (value >= VALUE)], minlength=180), hue.size


def nearest_hue_name(hue: float) -> str:
    """The name of an OpenCV hue 0..179."""
    return min(_NAMED, key=lambda name: abs((hue - _middle_hue(*_NAMED[name]) + 90) % 180 - 90))


def covered_hue_names(colour: HsvRange) -> set[str]:
    """The names of the hues in a range: those whose
    middle lies in it, and the one nearest its own middle.
    """
    low = colour.parts[0][0][0]
    high = colour.parts[-1][1][0]
    span = (high - low) % 180
    return {nearest_hue_name(_middle_hue(low, high))} | {
        name for name in _NAMED if (_middle_hue(*_NAMED[name]) - low) % 180 <= span
    }


def _middle_hue(low: int, high: int) -> float:
    return (low + ((high - low) % 180) / 2) % 180


def _range_by_name(colour: str, key: str) -> HsvRange:
    if colour not in _NAMED:
        raise ConfigError(
            f"colours.{key}: found '{colour}'; possible: {', '.join(_NAMED)}, or low and "
            "high in HSV; "
            f'type: {key} = "{_closest_colour_name(colour)}"'
        )
    low, high = _NAMED[colour]
    return range_between((low, SATURATION, VALUE), (high, 255, 255))


def _closest_colour_name(colour: str) -> str:
    from difflib import get_close_matches

    return get_close_matches(colour, _NAMED, n=1, cutoff=0.0)[0]

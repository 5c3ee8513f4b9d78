"""Colours by name: what a name means in OpenCV's HSV (h 0..179, s and v 0..255)."""

from dataclasses import dataclass

import numpy as np

from ..errors import ConfigError
from ..settings import Colour
from ..types import Array

_NAMED: dict[str, tuple[int, int]] = {
    "red": (170, 9),
    "orange": (8, 22),
    "yellow": (20, 36),
    "green": (37, 85),
    "cyan": (80, 100),
    "blue": (98, 132),
    "magenta": (133, 172),
}
_SATURATION, _VALUE = 90, 50


@dataclass(frozen=True, eq=False)
class Range:
    """What counts as a colour: low, high (3,) uint8 HSV bounds, both included; low hue above high hue wraps round."""

    low: Array
    high: Array


def resolve(colour: Colour, key: str) -> Range:
    """The HSV range of a setting `key`; raises ConfigError for a name not in the table or bounds out of range."""
    if isinstance(colour, str):
        return _by_name(colour, key)
    try:
        bounds = np.array([colour["low"], colour["high"]], dtype=np.int64)
    except (KeyError, TypeError, ValueError):
        bounds = np.zeros(0, dtype=np.int64)
    if bounds.shape != (2, 3) or (bounds < 0).any() or (bounds > (180, 255, 255)).any():
        raise ConfigError(
            f"colours.{key}: found {dict(colour)}; possible: low = [h, s, v] and high = [h, s, v] with h 0..180, "
            f"s and v 0..255; type: {key} = {{low = [37, 90, 50], high = [85, 255, 255]}}"
        )
    return Range(bounds[0].astype(np.uint8), bounds[1].astype(np.uint8))


def mask(hsv: Array, colour: Range) -> Array:
    """255 where hsv (H,W,3) lies in the range, else 0: (H,W) uint8."""
    import cv2

    low, high = colour.low, colour.high
    if low[0] <= high[0]:
        return np.asarray(cv2.inRange(hsv, low, high))
    upper = cv2.inRange(hsv, low, np.array([179, high[1], high[2]], dtype=np.uint8))
    lower = cv2.inRange(hsv, np.array([0, low[1], low[2]], dtype=np.uint8), high)
    return np.asarray(cv2.bitwise_or(upper, lower))


def names() -> tuple[str, ...]:
    """The colour names a setting may use."""
    return tuple(_NAMED)


def nearest(hue: float) -> str:
    """The name of an OpenCV hue 0..179."""
    return min(_NAMED, key=lambda name: abs((hue - _middle(*_NAMED[name]) + 90) % 180 - 90))


def _middle(low: int, high: int) -> float:
    return (low + ((high - low) % 180) / 2) % 180


def _by_name(colour: str, key: str) -> Range:
    if colour not in _NAMED:
        raise ConfigError(
            f"colours.{key}: found '{colour}'; possible: {', '.join(_NAMED)}, or low and high in HSV; "
            f"type: {key} = \"{_closest(colour)}\""
        )
    low, high = _NAMED[colour]
    return Range(
        np.array([low, _SATURATION, _VALUE], dtype=np.uint8), np.array([high, 255, 255], dtype=np.uint8)
    )


def _closest(colour: str) -> str:
    from difflib import get_close_matches

    return get_close_matches(colour, _NAMED, n=1, cutoff=0.0)[0]

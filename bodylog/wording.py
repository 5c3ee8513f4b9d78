"""Lists and quantities in sentences."""

from collections.abc import Sequence
from math import degrees

UNUSABLE_URDF = "the log's URDF is not used"
"""In the finding on a log's own URDF that cannot be read."""


def list_in_words(texts: Sequence[str], what: str = "", between: str = ", ", unit: str = "") -> str:
    """The first three texts, their unit, and how many more there are (of `what`)."""
    more = len(texts) - 3
    return (
        between.join(texts[:3])
        + unit
        + f"{';' * (';' in between)} and {more}{what} more" * (more > 0)
    )


def quantity_text(value: float, std: float | None, unit: str, signed: bool = False) -> str:
    """A value ± its standard deviation (None: unknown) with
    its unit: angles in rad and degrees, lengths in mm.
    """
    if unit == "m":
        value = 1e3 * value
        std = None if std is None else 1e3 * std
        unit = "mm"
    text = _with_std(value, std, signed)
    if unit == "rad":
        turned = _with_std(degrees(value), None if std is None else degrees(std), signed)
        return f"{text} rad ({turned}°)"
    return f"{text} {unit}"


def _with_std(value: float, std: float | None, signed: bool) -> str:
    number = f"{value:+.3g}" if signed else f"{value:.3g}"
    return number if std is None else f"{number} ± {std:.2g}"

"""Lists in sentences."""

from collections.abc import Sequence


def listed(texts: Sequence[str], what: str = "", between: str = ", ", unit: str = "") -> str:
    """The first three texts, their unit, and how many more there are (of `what`)."""
    more = len(texts) - 3
    return between.join(texts[:3]) + unit + f"{';' * (';' in between)} and {more}{what} more" * (more > 0)

"""Lists in sentences."""

from collections.abc import Sequence


def listed(texts: Sequence[str], what: str = "", between: str = ", ") -> str:
    """The first three texts, and how many more there are (of `what`)."""
    more = len(texts) - 3
    last = f"{';' * (';' in between)} and {more}{what} more" if more > 0 else ""
    return between.join(texts[:3]) + last

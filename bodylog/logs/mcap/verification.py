"""Verify a written file by its message indexes before it takes its final name."""

from pathlib import Path

from ...errors import FormatError, LogError
from .prefix import count_messages


def verify_message_count(beside: Path, expected: int, out: Path) -> None:
    """Open the written file and count its messages by its message indexes."""
    try:
        found = count_messages(beside)
    except FormatError as problem:
        raise LogError(f"{out}: was not written correctly ({problem}); is the disk full?") from None
    if found != expected:
        raise LogError(
            f"{out}: holds {found} messages where {expected} were written; is the disk full?"
        )

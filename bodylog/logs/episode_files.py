"""The files of a log: its own, or those of one episode of a dataset."""

from pathlib import Path

from ..errors import BodylogError
from ..io import episodes
from ..io.atomic_files import sha256


def files_of(path: Path) -> tuple[Path, ...]:
    """The file or folder of a log; for an episode, or a dataset (its first episode), the files it is read from.

    A dataset that cannot be read gives its own path.
    """
    base, number = episodes.split(path)
    if not base.is_dir():
        return (base,)
    from .datasets import kinds

    try:
        return kinds.files(base, number) or (base,)
    except BodylogError:
        return (base,)


def digest(path: Path) -> str:
    """Hex SHA-256 of a log; for an episode, of its files in order."""
    return sha256(*files_of(path))

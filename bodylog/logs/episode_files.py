"""The files of a log: its own, or those of one episode of a dataset."""

from pathlib import Path

from ..errors import BodylogError
from ..io import episodes
from ..io.atomic_files import hash_files


def files_of(path: Path) -> tuple[Path, ...]:
    """The file or folder of a log; for an episode, or a
    dataset (its first episode), the files it is read from.

    A dataset that cannot be read gives its own path.
    """
    base, number = episodes.split_episode_name(path)
    if not base.is_dir():
        return (base,)
    from .datasets import kinds

    try:
        return kinds.episode_files(base, number) or (base,)
    except BodylogError:
        return (base,)


def hash_log(path: Path) -> str:
    """Hex SHA-256 of a log; for an episode, of its files in order."""
    return hash_files(*files_of(path))

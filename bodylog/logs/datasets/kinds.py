"""Detect datasets: which reader opens a folder or
file, the files of an episode, the number of episodes.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ..limits import Input

if TYPE_CHECKING:
    from .episode_log import EpisodeLog

Opener = Callable[[Path, bool, Input], "EpisodeLog"]
"""Dataset or episode, strict, limits -> the log."""
_RECORDED = (".db3", ".mcap", ".bag", ".zst", ".zstd", ".lz4", ".active")


def of_folder(folder: Path) -> Opener | None:
    """The reader of a dataset's folder; None for other
    folders, and those recorded by rosbag2 or ROS.
    """
    if is_episode_dataset(folder):
        from . import lerobot

        return lerobot.open_lerobot
    names = [path.name for path in folder.iterdir()]
    if "metadata.yaml" in names or any(name.endswith(_RECORDED) for name in names):
        return None
    from . import tables

    return tables.open_folder if tables.is_tables(folder) else None


def of_file(first: bytes) -> Opener | None:
    """The reader of a file that begins with these bytes; None if it is neither HDF5 nor a video."""
    from . import hdf5, hdf5_file, tables, video

    if first.startswith(hdf5_file.MAGIC):
        return hdf5.open_hdf5
    return tables.open_video if video.is_video(first) else None


def is_episode_dataset(folder: Path) -> bool:
    """Whether a folder is a dataset of episodes, or was one before its info.json was lost."""
    meta = folder / "meta"
    listed = (meta / "episodes.jsonl").is_file() or (meta / "episodes").is_dir()
    return listed or (meta / "info.json").is_file()


def episode_files(folder: Path, number: int | None) -> tuple[Path, ...]:
    """The files of one episode of a dataset's folder; none for a folder without episodes."""
    from . import lerobot

    return lerobot.lerobot_episode_files(folder, number) if is_episode_dataset(folder) else ()


def episode_numbers(path: Path) -> tuple[int, ...]:
    """The numbers of the episodes in a folder or file; empty if it holds no episodes."""
    from . import hdf5_file, lerobot_layout

    if path.is_dir():
        return (
            lerobot_layout.read_dataset_layout(path).present() if is_episode_dataset(path) else ()
        )
    if not path.is_file():  # opening a pipe would block
        return ()
    with path.open("rb") as stream:
        is_hdf5 = stream.read(8) == hdf5_file.MAGIC
    return hdf5_file.demonstration_numbers(path) if is_hdf5 else ()

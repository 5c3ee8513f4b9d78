"""Open any log: the first bytes of a file select its reader in FORMATS; the files of a log."""

from collections.abc import Collection, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ..errors import BodylogError, LogError
from ..io import episodes
from ..io.atomic_files import hash_files, require_regular
from .limits import LIMITS, Input
from .mcap.records import MAGIC
from .protocol import Batches, Log, Opener
from .records import Batch
from .storage.packed_files import is_packed, unpack_file

if TYPE_CHECKING:
    from .decode.columns import Source


VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".webm", ".m4v")


_MP4 = b"ftyp"


_HDF5 = b"\x89HDF\r\n\x1a\n"


_LFS = b"version https://git-lfs"


def open_log(path: Path, strict: bool = False, limits: Input = LIMITS) -> Log:
    """Open the log in a file or folder; LogError when it
    is not a log, or when `strict` and part of it is lost.

    `limits`: how much compressed data may expand to.
    """
    place = episodes.dataset_path(path)
    if not place.exists():
        raise LogError(f"{path}: there is no such file or folder; check the name")
    try:
        if place.is_dir():
            return _open_folder(path, strict, limits)
        require_regular(place)
        first = _read_first_bytes(place)
        if is_episode_file(path):
            return _open_episode_file(path, first, strict, limits)
        if is_packed(first):
            return unpack_file(
                path,
                lambda inner: _open_local_log(path, strict, inner, limits),
                limits,
                partial(_choose_opener, path),
            )
        return _open_local_log(path, strict, path, limits)
    except OSError as problem:
        raise LogError(f"{path}: it cannot be read: {problem.strerror or problem}") from None


def is_episode_file(path: Path) -> bool:
    """Whether this names a file that is opened as an episode of a dataset, or as a video."""
    place = episodes.dataset_path(path)
    if not place.is_file():
        return False
    first = _read_first_bytes(place)
    is_video = first[4:8] == _MP4 or place.suffix.lower() in VIDEOS
    return place != path or first.startswith(_HDF5) or is_video


def _read_first_bytes(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(32)


def _open_local_log(path: Path, strict: bool, source: Path, limits: Input) -> Log:
    return _choose_opener(path, _read_first_bytes(source))(path, strict, source, limits)


def _choose_opener(path: Path, first: bytes) -> "Opener":
    """The reader for a log that begins with these bytes; LogError for other files."""
    for magic, opener in FORMATS.items():
        if first.startswith(magic):
            return opener
    from .tables.table_file import table_format

    if first and not first.startswith(_LFS) and table_format(path):
        return _open_pose_table
    known = (
        "logs are .mcap, .bag, .db3 or a rosbag2 folder; datasets; tables of poses .csv, "
        ".parquet, .yaml"
    )
    raise LogError(f"{path}: {_describe_file(first)}; {known}")


def without_images(log: Log) -> "Source":
    """The log without images that would have to be decoded from a video."""
    heads: Batches | None = getattr(log, "heads", None)
    return log if heads is None else _Heads(heads)


class _Heads(NamedTuple):
    """An episode of a dataset without its images."""

    heads: "Batches"

    def batches(self, ids: Collection[int]) -> Iterator[Batch]:
        """Messages of the topics; those of cameras carry no image."""
        return self.heads(ids)


def payload_views(batch: Batch) -> Iterator[memoryview]:
    """The payload of each message of a batch as a view, valid as long as the batch."""
    data = batch.data.data
    ends = batch.offset + batch.length
    return (
        data[start:end] for start, end in zip(batch.offset.tolist(), ends.tolist(), strict=True)
    )


def _describe_file(first: bytes) -> str:
    if not first:
        return "the file is empty"
    if first.startswith(_LFS):
        return "this is a git-LFS pointer, not the log itself; type: git lfs pull"
    if first.startswith((b"\x89MCAP0\n", b"\x89MCAP\n", b"\x89MCAP0\r\r\n")):
        return (
            "an MCAP whose line ends were converted, so damaged throughout; copy it again as a "
            "binary file"
        )
    if first.startswith(b"#ROSBAG V"):
        version = str(first[9:12], "ascii", "replace")
        return (
            f"a ROS 1 bag of version {version}, where only V2.0 is read; type: rosbag fix "
            "OLD.bag NEW.bag"
        )
    return f"not a log: it begins with {first[:12]!r}"


def _open_mcap(path: Path, strict: bool, source: Path, limits: Input) -> Log:
    from .mcap.reader import McapLog

    return McapLog(path, strict, source, limits)


def _open_bag(path: Path, strict: bool, source: Path, limits: Input) -> Log:
    from .rosbag1.reader import BagLog

    return BagLog(path, strict, source, limits)


def _open_db3(path: Path, strict: bool, source: Path, limits: Input) -> Log:
    from .rosbag2.sqlite3 import Db3Log

    return Db3Log(path, strict, source, limits)


def _open_pose_table(path: Path, strict: bool, source: Path, limits: Input) -> Log:
    from .tables.pose_log import PoseLog

    return PoseLog(path, strict, source, limits)


def _open_episode_file(path: Path, first: bytes, strict: bool, limits: Input) -> Log:
    """Open a file of episodes, or a video."""
    from .datasets import kinds

    opener = kinds.of_file(first)
    if opener is None:
        what = (
            "is not a dataset, so it has no episodes; leave out the #"
            if episodes.dataset_path(path) != path
            else "is not a video"
        )
        raise LogError(f"{path}: {episodes.dataset_path(path)} {what}")
    return opener(path, strict, limits)


def _open_folder(path: Path, strict: bool, limits: Input) -> Log:
    """Open a dataset's folder, else a rosbag2 folder."""
    from .datasets import kinds

    opener = kinds.of_folder(episodes.dataset_path(path))
    if opener is not None:
        return opener(path, strict, limits)
    if episodes.dataset_path(path) != path:
        raise LogError(
            f"{path}: {episodes.dataset_path(path)} is not a dataset, so it has no episodes; "
            "leave out the #"
        )
    return _open_rosbag2(path, strict, limits)


def _open_rosbag2(path: Path, strict: bool, limits: Input) -> Log:
    from .rosbag2.folder import Rosbag2Log

    return Rosbag2Log(path, strict, limits, open_log)


FORMATS: Mapping[bytes, Opener] = {
    MAGIC: _open_mcap,
    b"#ROSBAG V2.0": _open_bag,
    b"SQLite format 3\x00": _open_db3,
    b"PAR1": _open_pose_table,
}
"""First bytes of a file -> function that opens it."""


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

"""Recorded robot logs as arrays: MCAP, ROS 1 bags and rosbag2 folders; packed, split, damaged, or behind a URL.

    import bodylog.logs as logs

    with logs.open("run.bag") as log:
        joints = log["/joint_states"]
        joints.position, joints.header.stamp, joints.log_ns     # (N,K) · (N,) int64 ns · (N,) int64 ns

This room knows bytes, containers and messages. Everything here raises `bodylog.errors.BodylogError` with one line.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .decode.table import Table
    from .library import OpenLog
    from .records import Finding
    from .writer import Writer

__all__ = ["Writer", "convert", "examine", "open", "read", "repair"]


def open(path: str | Path, strict: bool = False, episode: int | None = None) -> "OpenLog":
    """A log of any container, path or URL; LogError when it is none, or when `strict` and part of it is lost.

    episode: the number of an episode of a dataset; the path DATASET#N means the same.
    """
    from .library import OpenLog

    return OpenLog(path, strict, episode)


def read(path: str | Path, fields: Mapping[str, Sequence[str]]) -> "dict[str, Table]":
    """Fields of several topics, {topic: [message path, …]}, in one pass over the file; ConfigError for unknown ones."""
    with open(path) as log:
        return log.read(fields)


def examine(path: str | Path) -> "tuple[Finding, ...]":
    """Everything wrong with a log, read from end to end."""
    from .conversion.examination import examine
    from .library import located

    with located(path) as here:
        return examine(here)


def repair(path: str | Path, out: str | Path) -> "tuple[Finding, ...]":
    """Write the sound messages of a log to the MCAP `out`; what was wrong is returned."""
    from .conversion.rewrite import repair
    from .library import located

    with located(path) as here:
        return repair(here, Path(out))


def convert(
    path: str | Path, out: str | Path, topics: Sequence[str] | None = None,
    start: float | None = None, end: float | None = None,
) -> "tuple[Finding, ...]":  # fmt: skip
    """Write a log as a chunked, indexed MCAP; ROS 1 messages become CDR.

    topics: only these · start, end: only what was logged between them, s since the log's start. `bodylog.convert`
    writes datasets.
    """
    from .conversion.extract import convert
    from .library import located

    with located(path) as here:
        return convert(here, Path(out), topics, start, end)


def __getattr__(name: str) -> Any:
    """`Writer`, imported when it is asked for."""
    if name == "Writer":
        from .writer import Writer

        return Writer
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

"""Recorded robot logs as arrays: MCAP, ROS 1 bags and
rosbag2 folders; compressed, split, damaged, or behind a URL.

    import bodylog.logs as logs

    with logs.open("run.bag") as log:
        joints = log["/joint_states"]
        joints.position, joints.header.stamp, joints.log_ns     # (N,K) · (N,) int64 ns · (N,) int64 ns

This package knows bytes, containers and messages, nothing of robots. Unusable input raises a
one-line `bodylog.errors.BodylogError`.
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


def open(
    path: str | Path,
    strict: bool = False,
    episode: int | None = None,
    max_wait_s: float | None = None,
) -> "OpenLog":
    """Open a log of any container, path or URL; LogError when
    it is not a log, or when `strict` and part of it is lost.

    episode: the number of an episode of a dataset; the path DATASET#N means the same · max_wait_s:
    s without an answer after which a URL's server is given up.
    """
    from .library import OpenLog

    return OpenLog(path, strict, episode, max_wait_s)


def read(path: str | Path, fields: Mapping[str, Sequence[str]]) -> "dict[str, Table]":
    """Read fields of several topics, {topic: [message
    path, …]}, in one pass; ConfigError for unknown ones.
    """
    with open(path) as log:
        return log.read(fields)


def examine(path: str | Path) -> "tuple[Finding, ...]":
    """Read a log from end to end and return everything that is wrong with it."""
    from .conversion.examination import examine_log_file
    from .library import findings_about, local_path

    with local_path(path) as here:
        return findings_about(examine_log_file(here), here, path)


def repair(path: str | Path, out: str | Path) -> "tuple[Finding, ...]":
    """Write the sound messages of a log to the MCAP `out`; return what is wrong with the log."""
    from .conversion.rewrite import rewrite_sound_messages
    from .library import findings_about, local_path

    with local_path(path) as here:
        return findings_about(rewrite_sound_messages(here, Path(out)), here, path)


def convert(
    path: str | Path,
    out: str | Path,
    topics: Sequence[str] | None = None,
    start: float | None = None,
    end: float | None = None,
) -> "tuple[Finding, ...]":
    """Write a log as a chunked, indexed MCAP; ROS 1 messages become CDR.

    topics: only these · start, end: only messages logged between them, s since the log's start.
    `bodylog.convert` writes datasets.
    """
    from .conversion.extract import convert_to_mcap
    from .library import findings_about, local_path

    with local_path(path) as here:
        return findings_about(convert_to_mcap(here, Path(out), topics, start, end), here, path)


def __getattr__(name: str) -> Any:
    """Import `Writer` on first use."""
    if name == "Writer":
        from .writer import Writer

        return Writer
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

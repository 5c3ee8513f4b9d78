"""What every log can do, whatever its container, and who opens one."""

from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from .limits import Input
from .records import Batch, Finding, Topic


class Log(Protocol):
    """One recorded log: its topics, when it was, and its messages, undecoded."""

    path: Path
    topics: tuple[Topic, ...]
    start_ns: int
    end_ns: int

    @property
    def format(self) -> str:
        """mcap, bag, rosbag2, db3; csv, parquet or yaml for a table of poses."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was found wrong so far; reading on may add to it."""

    def batches(self, ids: Collection[int] | None = None) -> Iterator[Batch]:
        """Messages of the topics `ids` (None: all) in file order, one batch per topic and chunk or block."""

    def spans(self) -> Mapping[int, tuple[int, int]]:
        """First and last log time (ns) by topic id, of the topics for which the file says so without being read."""

    def close(self) -> None:
        """Let go of the file."""

    def __enter__(self) -> Self:
        """The log itself."""

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""


Batches = Callable[[Collection[int]], Iterator[Batch]]
"""Topic ids -> their messages."""


Opener = Callable[[Path, bool, Path, Input], Log]
"""Log's path, strict, the file to read (unpacked, if it was packed), limits -> the log."""

"""The interface of every log, whatever its container, and of the functions that open one."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from .limits import Input
from .records import Batch, Finding, Topic


class Log(Protocol):
    """One recorded log: topics, time span and undecoded messages."""

    path: Path
    topics: tuple[Topic, ...]
    start_ns: int
    end_ns: int

    @property
    def format(self) -> str:
        """mcap, bag, rosbag2, db3; csv, parquet or yaml for a table of poses."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Problems found so far; further reading may add to them."""

    def batches(self, ids: Collection[int] | None = None) -> Iterator[Batch]:
        """Messages of the topics `ids` (None: all) in file
        order, one batch per topic and chunk or block.
        """

    def spans(self) -> Mapping[int, tuple[int, int]]:
        """First and last log time (ns) by topic id, where the file tells without being read."""

    def close(self) -> None:
        """Close the file."""

    def __enter__(self) -> Self:
        """Return the log."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file."""


Batches = Callable[[Collection[int]], Iterator[Batch]]
"""Topic ids -> their messages."""


Opener = Callable[[Path, bool, Path, Input], Log]
"""Log's path, strict, the file to read (decompressed if necessary), limits -> the log."""

Progress = Callable[[int], None]
"""Called with how many more messages are done."""


def count_progress(batches: Iterable[Batch], progress: Progress | None) -> Iterator[Batch]:
    """Yield the batches; `progress` is called with the number of messages of each that is done."""
    for batch in batches:
        yield batch
        if progress is not None:
            progress(len(batch.log_ns))

"""The content of an MCAP file, as far as it was surveyed, and the span of each topic's times."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..records import Array
from . import opcodes as op
from .chunks import Chunk, LooseRecords, index_of
from .records import Record


@dataclass
class McapSurvey:
    """Schemas, channels and message counts by id, parts in file order, log times (ns)."""

    schemas: dict[int, Record] = field(default_factory=dict)
    channels: dict[int, Record] = field(default_factory=dict)
    parts: list[Chunk | LooseRecords] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    times: list[int] = field(default_factory=list)

    def declare(self, record: Record) -> None:
        """Add a Schema or Channel; the first one of an id is kept."""
        known = self.schemas if record.opcode == op.SCHEMA else self.channels
        known.setdefault(record.fields["id"], record)

    def knows(self, channels: Iterable[int]) -> bool:
        """Whether each of these channels, and its schema if it has one, is declared."""
        known = [self.channels.get(channel) for channel in channels]
        return all(
            one is not None and one.fields["schema_id"] in (0, *self.schemas) for one in known
        )

    def count(self, channels: Array, log_ns: Array) -> None:
        """Count messages by channel id (n,) and log time (n,) ns."""
        if len(channels):
            numbers = np.bincount(channels)
            for channel in np.flatnonzero(numbers).tolist():
                self.counts[channel] = self.counts.get(channel, 0) + int(numbers[channel])
            self.times += [int(log_ns.min()), int(log_ns.max())]


def spans_of(
    data: memoryview, parts: Sequence[Chunk | LooseRecords], topic_of: Array
) -> dict[int, tuple[int, int]]:
    """First and last log time (ns) by topic id; empty when messages lie outside indexed chunks."""
    first: dict[int, int] = {}
    last: dict[int, int] = {}
    for part in parts:
        if isinstance(part, LooseRecords) or not part.indexes:
            return {}
        for channel, at in part.indexes.items():
            first.setdefault(channel, at)
            last[channel] = at
    spans: dict[int, tuple[int, int]] = {}
    for channel, at in first.items():
        starts = index_of(data, at)[:, 0]
        ends = index_of(data, last[channel])[:, 0]
        if len(starts) and len(ends):
            widen_time_span(spans, int(topic_of[channel]), (int(starts.min()), int(ends.max())))
    return spans


def widen_time_span(spans: dict[int, tuple[int, int]], topic: int, span: tuple[int, int]) -> None:
    """Widen a topic's time span by another."""
    low, high = spans.get(topic, span)
    spans[topic] = min(low, span[0]), max(high, span[1])

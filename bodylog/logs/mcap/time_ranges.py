"""First and last log time of each topic of an MCAP,
from the message indexes of its first and last chunk.
"""

from collections.abc import Sequence

from ..records import Array
from .chunks import Chunk, LooseRecords, index_of


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

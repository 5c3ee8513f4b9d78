"""When each topic of an MCAP begins and ends, by the message indexes of its first and last chunk alone."""

from collections.abc import Sequence

from ..records import Array
from .chunks import Chunk, Loose, index_of


def spans_of(data: memoryview, parts: Sequence[Chunk | Loose], topic_of: Array) -> dict[int, tuple[int, int]]:
    """First and last log time (ns) by topic id; of none when messages lie where no index says so."""
    first: dict[int, int] = {}
    last: dict[int, int] = {}
    for part in parts:
        if isinstance(part, Loose) or not part.indexes:
            return {}
        for channel, at in part.indexes.items():
            first.setdefault(channel, at)
            last[channel] = at
    spans: dict[int, tuple[int, int]] = {}
    for channel, at in first.items():
        begun, ended = index_of(data, at)[:, 0], index_of(data, last[channel])[:, 0]
        if len(begun) and len(ended):
            widen(spans, int(topic_of[channel]), (int(begun.min()), int(ended.max())))
    return spans


def widen(spans: dict[int, tuple[int, int]], topic: int, span: tuple[int, int]) -> None:
    """Take in one more span of a topic."""
    low, high = spans.get(topic, span)
    spans[topic] = min(low, span[0]), max(high, span[1])

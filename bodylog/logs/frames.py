"""The camera's frames, lazily and in time order; each holds its own bytes."""

import heapq
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from ..types import Array, Frame, Topic
from . import images
from .clocks import seconds
from .containers import open_log, payloads
from .mapping import lasts
from .walker import Payload


def frames(
    path: Path,
    strict: bool,
    topics: tuple[Topic, ...],
    counts: tuple[int, ...],
    rows: Array,
    t_ns: Array,
    start_ns: int,
) -> Callable[[], Iterator[Frame]]:
    """A function that reads the log again and yields the frames dated t_ns (m,), which are the messages rows (m,).

    Rows count through the topics in order, `counts` messages each. Messages that come early wait, so memory
    grows with the disorder of the file, not with its length.
    """
    rank = np.full(sum(counts), -1)
    rank[rows] = np.arange(len(rows))
    starts = np.concatenate([[0], np.cumsum(counts)])[:-1]
    places = {topic.id: rank[start : start + n] for topic, start, n in zip(topics, starts, counts, strict=True)}
    decoders = {topic.id: images.decoder(topic) for topic in topics}
    shrink = {topic.id: topic.type in images.COMPRESSED for topic in topics}
    t = seconds(t_ns, start_ns)

    def read() -> Iterator[Frame]:
        waiting: list[tuple[int, Frame]] = []
        due = 0
        for number, frame in _frames(path, strict, places, decoders, shrink, t):
            heapq.heappush(waiting, (number, frame))
            while waiting and waiting[0][0] == due:
                yield heapq.heappop(waiting)[1]
                due += 1

    return read


def _frames(
    path: Path,
    strict: bool,
    places: dict[int, Array],
    decoders: dict[int, Callable[[Payload, int], Array]],
    shrink: dict[int, bool],
    t: Array,
) -> Iterator[tuple[int, Frame]]:
    seen = dict.fromkeys(places, 0)
    with open_log(path, strict) as log:
        for batch in log.batches(tuple(places)):
            id_ = batch.topic_id
            numbers = places[id_][seen[id_] : seen[id_] + len(batch.log_ns)].tolist()
            seen[id_] += len(batch.log_ns)
            keep = lasts(batch.data)
            for number, log_ns, payload in zip(numbers, batch.log_ns.tolist(), payloads(batch), strict=True):
                if number >= 0:
                    decode = partial(decoders[id_], payload if keep else bytes(payload))
                    yield number, Frame(float(t[number]), log_ns, decode, shrink[id_])

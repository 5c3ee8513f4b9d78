"""The camera's frames, passed on while the log is read,
or read lazily in time order; each holds its own bytes.
"""

import heapq
from collections.abc import Callable, Collection, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from ..logs.decode.cursor import Payload
from ..logs.formats import open_log, payload_views
from ..logs.images import messages
from ..logs.limits import Input
from ..logs.protocol import Log
from ..logs.storage.mmapped import is_mapped
from ..types import Array, Batch, ConsumedFrames, FrameConsumer, Frames, LazyImage, Topic
from .clocks import seconds_since


class FrameTap:
    """A log that passes its camera's images to a consumer while others read its batches."""

    def __init__(
        self, log: Log, topics: tuple[Topic, ...], consumer: FrameConsumer, limits: Input
    ) -> None:
        """The camera's topics: one name, several ids if it has several schemas."""
        self._log = log
        self._consumer = consumer
        self._count = 0
        self._decoders = {
            topic.id: messages.make_image_decoder(topic, limits.max_image_mpx) for topic in topics
        }
        self._shrinks = {topic.id: topic.type in messages.COMPRESSED for topic in topics}
        self._numbers: dict[int, list[Array]] = {
            topic.id: [np.empty(0, np.int64)] for topic in topics
        }

    def batches(self, ids: Collection[int]) -> Iterator[Batch]:
        """Batches of the log."""
        for batch in self._log.batches(ids):
            if batch.topic_id in self._decoders:
                self._pass_on(batch)
            yield batch

    def consumed(self, rows: Array, t_ns: Array, source_ns: Array, start_ns: int) -> ConsumedFrames:
        """The passed frames with times t_ns (n,): the messages
        rows (n,), counted through the topics in order.
        """
        numbers = np.concatenate([number for some in self._numbers.values() for number in some])
        return ConsumedFrames(
            seconds_since(t_ns, start_ns), source_ns, numbers[rows], self._consumer
        )

    def _pass_on(self, batch: Batch) -> None:
        id_ = batch.topic_id
        self._numbers[id_].append(np.arange(self._count, self._count + len(batch.log_ns)))
        self._count += len(batch.log_ns)
        held = np.zeros_like(batch.length) if is_mapped(batch.data) else batch.length
        decoders = _message_decoders(batch, self._decoders[id_])
        for log_ns, decode, size in zip(
            batch.log_ns.tolist(), decoders, held.tolist(), strict=True
        ):
            self._consumer(LazyImage(float("nan"), log_ns, decode, self._shrinks[id_], size))


def read_frames_lazily(
    path: Path,
    limits: Input,
    topics: tuple[Topic, ...],
    counts: tuple[int, ...],
    rows: Array,
    t_ns: Array,
    start_ns: int,
) -> Frames:
    """A function that reads the log again and yields the
    frames at t_ns (m,), which are the messages rows (m,).

    Rows count through the topics in order, `counts` messages each. Early messages are held back, so
    memory grows with the disorder of the file, not with its length.
    """
    rank = np.full(sum(counts), -1)
    rank[rows] = np.arange(len(rows))
    starts = np.concatenate([[0], np.cumsum(counts)])[:-1]
    places = {
        topic.id: rank[start : start + n]
        for topic, start, n in zip(topics, starts, counts, strict=True)
    }
    decoders = {
        topic.id: messages.make_image_decoder(topic, limits.max_image_mpx) for topic in topics
    }
    shrink = {topic.id: topic.type in messages.COMPRESSED for topic in topics}
    t = seconds_since(t_ns, start_ns)

    def read() -> Iterator[LazyImage]:
        waiting: list[tuple[int, LazyImage]] = []
        due = 0
        for number, frame in _numbered_frames(path, limits, places, decoders, shrink, t):
            heapq.heappush(waiting, (number, frame))
            while waiting and waiting[0][0] == due:
                yield heapq.heappop(waiting)[1]
                due += 1

    return read


def _numbered_frames(
    path: Path,
    limits: Input,
    places: dict[int, Array],
    decoders: dict[int, Callable[[Payload, int], Array]],
    shrink: dict[int, bool],
    t: Array,
) -> Iterator[tuple[int, LazyImage]]:
    seen = dict.fromkeys(places, 0)
    with open_log(path, limits.strict, limits) as log:
        for batch in log.batches(tuple(places)):
            id_ = batch.topic_id
            numbers = places[id_][seen[id_] : seen[id_] + len(batch.log_ns)].tolist()
            seen[id_] += len(batch.log_ns)
            decodes = _message_decoders(batch, decoders[id_])
            for number, log_ns, decode in zip(numbers, batch.log_ns.tolist(), decodes, strict=True):
                if number >= 0:
                    yield number, LazyImage(float(t[number]), log_ns, decode, shrink[id_])


def _message_decoders(
    batch: Batch, decode: Callable[[Payload, int], Array]
) -> Iterator[Callable[[int], Array]]:
    """A decoder for each message of a batch, on a
    copy of its bytes unless the batch's stay valid.
    """
    keep = is_mapped(batch.data)
    return (
        partial(decode, payload if keep else bytes(payload)) for payload in payload_views(batch)
    )

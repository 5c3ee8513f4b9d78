"""Read ROS 1 bags (format 2.0) as undecoded batches;
only what the requested topics need is read.
"""

from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from ..limits import LIMITS, Input
from ..mapped_log import MappedLog
from ..records import Array, Batch, Topic
from ..storage.compression import Buffer
from ..storage.mmapped import drop_pages
from ..topics import TopicTable, log_time_span, split_by_topic_id
from .chunks import BagMessages, BagRun, list_bag_messages, load_bag_chunk, scan_messages
from .survey import BagSurvey


class BagLog(MappedLog):
    """One memory-mapped ROS 1 bag; see protocol.Log."""

    format = "bag"

    def __init__(
        self, path: Path, strict: bool = False, source: Path | None = None, limits: Input = LIMITS
    ) -> None:
        """Map `source` (default: `path`) and survey
        it; LogError when strict and something is lost.
        """
        from .scan import survey_bag

        super().__init__(path, strict, source, limits)
        self._survey = survey_bag(self._data, self._diagnostics)
        self.topics, self._topic_of = _bag_topics(self._survey)
        self.start_ns, self.end_ns = log_time_span(self._survey.times, self._diagnostics)

    def batches(self, ids: Collection[int] | None = None) -> Iterator[Batch]:
        """Messages of the topics `ids` (None: all) in
        file order, one batch per topic and chunk or run.
        """
        wanted = {c: t for c, t in self._topic_of.items() if ids is None or t in ids}
        buffer = Buffer(self.path, self._diagnostics.limits)
        for part in self._survey.parts:
            if isinstance(part, BagRun):
                whole = np.frombuffer(self._data, np.uint8)
                yield from _split_bag_messages(
                    whole,
                    scan_messages(self._data, part.start, part.end, part.start, self._diagnostics),
                    wanted,
                )
            elif not part.counts or wanted.keys() & part.counts.keys():
                loaded = load_bag_chunk(self._data, part, buffer, self._diagnostics)
                if loaded is not None:
                    content, indexes = loaded
                    yield from _split_bag_messages(
                        content,
                        list_bag_messages(
                            content, self._data, part.start, indexes, self._diagnostics
                        ),
                        wanted,
                    )
                    drop_pages(self._data, part.start, part.start + len(content))

    def spans(self) -> dict[int, tuple[int, int]]:
        """Empty: a bag's indexes give the times of chunks, not of topics."""
        return {}


def _bag_topics(survey: BagSurvey) -> tuple[tuple[Topic, ...], dict[int, int]]:
    topics = TopicTable()
    topic_of = {}
    for connection, fields in survey.connections.items():
        text = {
            name.decode(errors="replace"): value.decode(errors="replace")
            for name, value in fields.items()
        }
        kept = {
            name: value
            for name, value in text.items()
            if name in ("md5sum", "callerid", "latching")
        }
        definition = fields.get(b"message_definition", b"")
        name = text.get("topic", "")
        kind = text.get("type", "")
        count = survey.counts.get(connection, 0)
        topic_of[connection] = topics.add(name, kind, "ros1", definition, "ros1msg", count, kept)
    return topics.all(), topic_of


def _split_bag_messages(
    content: Array, found: BagMessages, wanted: dict[int, int]
) -> Iterator[Batch]:
    known, where = np.unique(found.connection, return_inverse=True)
    topic = np.array([wanted.get(int(one), -1) for one in known], np.int64)[where]
    return split_by_topic_id(topic, found.log_ns, content, found.offset, found.length)

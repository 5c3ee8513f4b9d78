"""Convert any log, or part of it, to a chunked, indexed MCAP."""

import math
from collections.abc import Sequence
from pathlib import Path

from ...errors import UsageError
from ...io.atomic_files import replace_atomically
from ...io.outputs import Output, guard_outputs
from ..formats import open_log
from ..mcap.verification import verify_message_count
from ..protocol import Progress
from ..records import Finding
from .transcode import Span, write_log_messages


def convert_to_mcap(
    path: Path,
    out: Path,
    topics: Sequence[str] | None = None,
    start: float | None = None,
    end: float | None = None,
    progress: Progress | None = None,
) -> tuple[Finding, ...]:
    """Write a log's messages to the MCAP `out`; ROS
    1 payloads become CDR, all else stays unchanged.

    topics: only these · start, end: only messages logged between
    them, s since the log's first message. UsageError for an unknown
    topic, an empty time span, or an output that is also the input.
    """
    guard_outputs([path], [Output(out, "out")])
    span = _check_topics_and_span(path, topics, start, end)
    with replace_atomically(out) as beside:
        with beside.open("wb") as stream:
            writer, count, findings = write_log_messages(
                path, stream, topics, ours=True, span=span, progress=progress
            )
            writer.finish()
        verify_message_count(beside, count, out)
    return findings


def _check_topics_and_span(
    path: Path, topics: Sequence[str] | None, start: float | None, end: float | None
) -> Span | None:
    with open_log(path) as log:
        known = sorted({topic.name for topic in log.topics})
        if unknown := [name for name in topics or () if name not in known]:
            raise UsageError(
                f"{path}: no topic {unknown[0]!r}; the topics are {', '.join(known) or 'none'}"
            )
        if start is None and end is None:
            return None
        first = 0.0 if start is None else start
        last = math.inf if end is None else end
        if not first <= last:
            raise UsageError(f"{path}: start {first:g} s is not before end {last:g} s")
        return log.start_ns + round(
            first * 1e9
        ), log.end_ns if last == math.inf else log.start_ns + round(last * 1e9)

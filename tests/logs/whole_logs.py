"""Every message that is read of a log, and what was found wrong with it."""

from pathlib import Path

from bodylog.logs.formats import open_log, payload_views
from bodylog.types import Finding

Read = list[tuple[str, int, bytes]]


def read(path: Path, strict: bool = False) -> tuple[Read, tuple[Finding, ...]]:
    found = []
    with open_log(path, strict) as log:
        names = {topic.id: topic.name for topic in log.topics}
        for batch in log.batches():
            for log_ns, payload in zip(batch.log_ns.tolist(), payload_views(batch), strict=True):
                found.append((names[batch.topic_id], log_ns, bytes(payload)))
        return found, log.findings

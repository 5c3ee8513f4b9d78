"""The content of a log as plain values: topics, rates, roles, joint names, clocks, findings."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import BodylogError
from ..logs.formats import open_log, without_images
from ..logs.protocol import Log
from ..logs.records import Finding, Topic
from ..settings import Settings
from . import joint_topics, roles
from .dated_streams import Stream, joints_of, read_streams
from .saved_settings import restore_settings
from .stream_findings import log_findings


def describe_log(path: Path, settings: Settings, strict: bool = False) -> dict[str, Any]:
    """The content of a log as plain values: topics, rates, roles, joint names, clocks, findings."""
    with open_log(path, strict, settings.input) as log:
        settings = restore_settings(log, settings)
        streams: dict[str, Stream] = {}
        found: dict[str, roles.Role] = {}
        try:
            found = roles.assign_roles(log.topics, settings.topics, str(path), joints_of(log))
            streams, silent = read_streams(without_images(log), found, settings, str(path))
            found = {role: stream.role for role, stream in streams.items()}
            remarked = (*silent, *log_findings(log, streams, settings))
        except BodylogError as error:
            remarked = (Finding("warning", str(error).removeprefix(f"{path}: ")),)
        spans = _spans_by_topic(log, streams)
        return {
            "path": str(path),
            "format": log.format,
            "start_ns": log.start_ns,
            "duration_s": (log.end_ns - log.start_ns) / 1e9,
            "topics": [
                _topic_facts(topic, spans)
                for topic in sorted(log.topics, key=lambda t: (t.name, t.id))
            ],
            "roles": {role: source.path for role, source in found.items()},
            "joints": list(joint_topics.merged_joint_names(streams)),
            "unit": joint_topics.unit_of_joints(streams),
            "clock": {role: _clock_facts(stream) for role, stream in streams.items()},
            "findings": [
                {"severity": f.severity, "text": f.text} for f in (*log.findings, *remarked)
            ],
        }


def _spans_by_topic(log: Log, streams: Mapping[str, Stream]) -> dict[int, tuple[int, int]]:
    """First and last log time (ns) by topic id: its own if known, else the log's."""
    whole = dict.fromkeys((topic.id for topic in log.topics), (log.start_ns, log.end_ns))
    alone = {
        stream.role.topics[0].id: stream.log_ns
        for stream in streams.values()
        if len(stream.role.topics) == 1
    }
    return (
        whole
        | {id_: (int(ns.min()), int(ns.max())) for id_, ns in alone.items()}
        | dict(log.spans())
    )


def _topic_facts(topic: Topic, spans: Mapping[int, tuple[int, int]]) -> dict[str, Any]:
    first, last = spans[topic.id]
    rate = (
        (topic.messages - 1) / (last - first) * 1e9 if topic.messages > 1 and last > first else None
    )
    return {"topic": topic.name, "type": topic.type, "messages": topic.messages, "rate_hz": rate}


def _clock_facts(stream: Stream) -> dict[str, Any]:
    timing = stream.timing
    offset_s = None if timing.offset_ns is None else timing.offset_ns / 1e9
    return {"clock": timing.clock, "offset_s": offset_s, "spread_s": timing.spread_s}

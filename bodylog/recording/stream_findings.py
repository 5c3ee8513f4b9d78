"""Findings on a log's streams: their clocks and
joints, what was rejected, and what else might be used.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from ..io.values import FARTHEST
from ..logs.protocol import Log
from ..logs.records import Finding
from ..settings import Settings
from . import role_hints
from .clocks import median_by_sorting, seconds_since
from .dated_streams import Stream, rejection_reasons


def log_findings(
    log: Log, streams: Mapping[str, Stream], settings: Settings
) -> tuple[Finding, ...]:
    """The roles for robot.toml, unused and unreadable topics, and the findings on each stream."""
    found = {role: stream.role for role, stream in streams.items()}
    advice = role_hints.advice_on_roles(found)
    unused = (role_hints.unused_joints, role_hints.unused_cameras)
    more = [finding for tell in unused for finding in tell(log.topics, settings.topics, found)]
    advised = [Finding("info", f"roles, ready for robot.toml: {advice}")] if streams else []
    broken = [
        Finding("warning", f"{text}; not considered for any role")
        for text in role_hints.find_unreadable_topics(log.topics)
    ]
    return (
        *advised,
        *more,
        *broken,
        *(finding for stream in streams.values() for finding in stream_findings(stream)),
    )


def stream_findings(stream: Stream) -> Iterator[Finding]:
    """Findings on a stream: its clocks, and sorted, slow or rejected messages."""
    timing = stream.timing
    name = f"{stream.role.role} {stream.role.topic}"
    if timing.offset_ns is not None:
        late = (
            f"{timing.offset_ns / 1e9:.6g} s after the header's, 5 to 95 % within "
            f"{timing.spread_s:.3g} s"
        )
        yield Finding("info", f"{name}: {timing.clock} time; log times are at the median {late}")
    if stream.shifted_s:
        by = f"{stream.shifted_s:.6g} s"
        yield Finding(
            "warning", f"{name}: its clock is not the others'; shifted by {by} to meet them"
        )
    yield from (Finding("warning", f"{name}: {text}") for text in _clock_steps(stream))
    if len(timing.backwards):
        yield Finding("warning", f"{name}: {_describe_backward_times(stream)}")
    if timing.out_of_order:
        yield Finding("info", f"{name}: {timing.out_of_order} messages out of order were sorted")
    if stream.fallback:
        yield Finding("info", f"{name}: {stream.fallback} messages were decoded one by one")
    if stream.beyond:
        yield Finding(
            "warning", f"{name}: {stream.beyond} readings beyond {FARTHEST:g} are rejected"
        )
    yield from (
        Finding("warning", f"{name}: {text}")
        for text in (*_changing_joint_lists(stream), *_vanishing_joints(stream))
    )
    for joint, count in stream.wraps.items():
        yield Finding(
            "info",
            f"{name}: {joint} wraps around, {count} times; read as one motion, without whole turns",
        )
    if stream.rejected:
        yield Finding(
            "warning",
            f"{name}: rejected {rejection_reasons(stream)} of {sum(stream.counts)} messages",
        )


_GONE = 1.0
_RARE = 10.0
"""Seconds, and median steps, without a reading at an end
of its topic after which a joint counts as missing there.
"""
_NAMED = 4


def _changing_joint_lists(stream: Stream) -> Iterator[str]:
    """Findings on a topic whose messages do not all name the same joints, with likely causes."""
    if len(stream.sets) < 2:
        return
    some = "; ".join(
        f"{', '.join(one.names)} ({len(one.rows)} messages)" for one in stream.sets[:_NAMED]
    )
    more = f"; and {len(stream.sets) - _NAMED} more" if len(stream.sets) > _NAMED else ""
    which = np.concatenate([np.full(len(one.rows), k) for k, one in enumerate(stream.sets)])
    which = which[np.argsort(np.concatenate([one.rows for one in stream.sets]), kind="stable")]
    switches = int((np.diff(which) != 0).sum())
    why = (
        "the list changes"
        if switches < 2 * len(stream.sets)
        else f"in turn, {switches} times: several publishers"
    )
    yield f"{len(stream.sets)} lists of joints on one topic, {why}: {some}{more}"


def _vanishing_joints(stream: Stream) -> Iterator[str]:
    """Joints without readings at the beginning or the end of a topic that continues."""
    if stream.role.role not in ("joints", "truth", "reference") or len(stream.timing.t_ns) < 2:
        return
    t = seconds_since(stream.timing.t_ns, int(stream.timing.t_ns[0]))
    for name, column in zip(stream.names, stream.values.T, strict=True):
        known = t[np.isfinite(column)]
        if len(known) < 2:
            continue
        long = max(_GONE, _RARE * median_by_sorting(np.diff(known)))
        if t[-1] - known[-1] > long:
            yield (
                f"{name} vanishes: no reading after {known[-1]:.3f} s, while others go on until "
                f"{t[-1]:.3f} s"
            )
        if known[0] > long:
            yield f"{name} has no reading before {known[0]:.3f} s"


def _clock_steps(stream: Stream) -> Iterator[str]:
    """Where a stream's clocks were set, by how much, and how its times were put onto one clock."""
    first = int(stream.log_ns[stream.rows.argmin()])
    recorder_rows = {step.row for step in stream.steps if step.clock == "log"}
    own_rows = {step.row for step in stream.steps if step.clock == "header"}
    for step in stream.steps:
        if step.clock == "header" and step.row in recorder_rows:
            continue
        whose = "its clock" if step.clock == "header" else "the recorder's clock"
        if step.row in own_rows & recorder_rows:
            whose = "its clock and the recorder's"
        way = "back" if step.by_ns > 0 else "forward"
        when = f"{(step.at_ns - first) / 1e9:.3f} s after its first message"
        known = "log time" if step.clock == "header" else "the usual time between messages"
        yield (
            f"{whose} stepped {way} by {abs(step.by_ns) / 1e9:.3f} s, {when}; "
            f"later times are put onto the clock before it, by {known}"
        )


def _describe_backward_times(stream: Stream) -> str:
    """Where a stream's times run backwards, and how they were handled."""
    timing = stream.timing
    first = min(int(stream.log_ns.min()), int(timing.backwards[0]))
    begin, end = ((int(ns) - first) / 1e9 for ns in (timing.backwards[0], timing.backwards[-1]))
    text = (
        f"times run backwards: {len(timing.backwards)} of {sum(stream.counts)} messages, "
        f"{begin:.3f} to {end:.3f} s"
    )
    if "time runs backwards" in timing.rejected:
        return f"{text} after its first, are far from the rest and left out"
    insist = f'type [time] {stream.role.role} = "header" in robot.toml to use header time'
    return (
        f"{text} after its first, are far from the rest by the header; log time is used instead, "
        f"{insist}"
    )

"""A log -> one Recording: roles, dated signals, lazy frames, and what became of every message."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BodylogError, LogError
from ..settings import Settings
from ..types import Array, Features, Finding, Frame, Health, Recording, Series, Topic
from . import frames as camera
from . import images, roles, signals, video
from .clocks import Dated, date, largest_gap, seconds
from .columns import Columns, columns_of
from .containers import Log, open_log
from .roles import Role
from .stamps import stamp_field

_MINUTE = 60.0
_OURS = "/bodylog/"
_JOINT_FIELDS = ("name", "position")


@dataclass(frozen=True, eq=False)
class _Stream:
    """One role's messages, dated: values (m,D), log_ns (m,), and the counts behind its health."""

    role: Role
    dated: Dated
    values: Array
    names: tuple[str, ...]
    log_ns: Array
    rows: Array
    counts: tuple[int, ...]
    rejected: Mapping[str, int]
    fallback: int


def read(path: Path, settings: Settings, strict: bool = False) -> Recording:
    """The recording in a log of any format; a role that is not there is None. LogError, FormatError as they come."""
    with open_log(path, strict) as log:
        found = roles.roles(log.topics, settings.topics, str(path))
        streams = _streams(log, found, settings, str(path))
        start_ns = _start_ns(streams, log)
        features = _features(log, start_ns)
        findings = (*log.findings, *_findings(log, found, streams))
    sidecar = _sidecar(path, settings)
    return Recording(
        name=path.name,
        format=log.format,
        start_ns=start_ns,
        duration_s=_duration(streams, log),
        topics=log.topics,
        roles={role: source.path for role, source in found.items()} | _said(sidecar, settings),
        joints=_series(streams.get("joints"), start_ns, "rad"),
        skin=_series(streams.get("skin"), start_ns, "0..1"),
        truth=_series(streams.get("truth"), start_ns, "rad"),
        frames=_frames(path, strict, streams.get("camera"), sidecar, settings, start_ns),
        features=features,
        health={role: _health(stream) for role, stream in streams.items()} | _seen(sidecar),
        findings=findings,
    )


def info(path: Path, settings: Settings, strict: bool = False) -> dict[str, Any]:
    """What is in a log, as plain values: topics, rates, roles, joint names, clocks, findings."""
    with open_log(path, strict) as log:
        problems: list[Finding] = []
        found: dict[str, Role] = {}
        streams: dict[str, _Stream] = {}
        try:
            found = roles.roles(log.topics, settings.topics, str(path))
            streams = _streams(log, found, settings, str(path))
        except BodylogError as error:
            problems.append(Finding("warning", str(error).removeprefix(f"{path}: ")))
        findings = (*log.findings, *problems, *(_findings(log, found, streams) if not problems else ()))
        duration_s = (log.end_ns - log.start_ns) / 1e9
        return {
            "path": str(path),
            "format": log.format,
            "start_ns": log.start_ns,
            "duration_s": duration_s,
            "topics": [_topic(topic, duration_s) for topic in sorted(log.topics, key=lambda t: (t.name, t.id))],
            "roles": {role: source.path for role, source in found.items()},
            "joints": list(streams["joints"].names) if "joints" in streams else [],
            "clock": {role: _clock(stream) for role, stream in streams.items()},
            "findings": [{"severity": finding.severity, "text": finding.text} for finding in findings],
        }


def _topic(topic: Topic, duration_s: float) -> dict[str, Any]:
    rate = (topic.messages - 1) / duration_s if topic.messages > 1 and duration_s > 0 else None
    return {"topic": topic.name, "type": topic.type, "messages": topic.messages, "rate_hz": rate}


def _clock(stream: _Stream) -> dict[str, Any]:
    dated = stream.dated
    return {"clock": dated.clock, "offset_s": dated.offset_s, "spread_s": dated.spread_s}


def _streams(log: Log, found: Mapping[str, Role], settings: Settings, name: str) -> dict[str, _Stream]:
    streams = {role: _stream(*read, settings, name) for role, read in _columns(log, found).items()}
    return _one_epoch({role: stream for role, stream in streams.items() if _is_usable(stream, settings, name)})


def _columns(log: Log, found: Mapping[str, Role]) -> dict[str, tuple[Role, tuple[Columns, ...]]]:
    fields: dict[int, dict[str, None]] = {}
    topics = {topic.id: topic for role in found.values() for topic in role.topics}
    for role in found.values():
        for topic in role.topics:
            stamp = stamp_field(topic)
            wanted = dict.fromkeys([stamp] if stamp else []) | dict.fromkeys(_fields(role))
            fields.setdefault(topic.id, {}).update(wanted)
    read = columns_of(log, {id_: (topics[id_], tuple(names)) for id_, names in fields.items()})
    return {name: (role, tuple(read[topic.id] for topic in role.topics)) for name, role in found.items()}


def _fields(role: Role) -> tuple[str, ...]:
    if role.role == "camera":
        return (images.text_field(role.topics[0]),)
    return (role.field,) if role.field else _JOINT_FIELDS


def _stream(role: Role, columns: tuple[Columns, ...], settings: Settings, name: str) -> _Stream:
    stamp = stamp_field(role.topics[0])
    found = list(signals.blocks(columns, stamp, _fields(role)))
    signal = _signal(role, found, settings, f"{name}: {role.topic}")
    log_ns = np.concatenate([some.log_ns for some in columns])
    choice = getattr(settings.time, role.role)
    if choice == "header" and signal.stamp_ns is None and len(signal.rows):
        raise LogError(f'{name}: [time] {role.role} = "header", but {role.topic} has no header; use "log" or "auto"')
    by_name = role.role in ("joints", "truth")
    dated = date(log_ns[signal.rows], signal.stamp_ns, choice, distinct=not by_name)
    values, idle = signal.values[dated.rows], 0
    if by_name:
        keep, values, idle = signals.merged(dated.t_ns, np.deg2rad(values) if settings.body.unit == "deg" else values)
        values, dated = values[keep], replace(dated, t_ns=dated.t_ns[keep], rows=dated.rows[keep])
    rejected = sum((Counter(some.rejected) for some in columns), Counter(signal.rejected) + Counter(dated.rejected))
    rejected.update({"same stamp again": idle} if idle else {})
    rows, counts = signal.rows[dated.rows], tuple(len(some.log_ns) for some in columns)
    slow = sum(some.fallback for some in columns)
    return _Stream(role, dated, values, signal.names, log_ns[rows], rows, counts, dict(rejected), slow)


def _signal(role: Role, found: list[signals.Block], settings: Settings, what: str) -> signals.Signal:
    if role.role == "camera":
        seen = {str(text) for _, _, (names,) in found for text in names}
        return signals.texts(found, {text: images.refusal(role.topics[0], text) for text in seen})
    if not role.field:
        return signals.joints(found, settings.body.joints, what, every=role.role == "joints")
    signal = signals.array(found)
    if role.role == "skin" or not len(signal.rows):
        return signal
    nameless = [(signal.rows, signal.stamp_ns, ((), signal.values))]
    return signals.joints(nameless, settings.body.joints, what)


def _is_usable(stream: _Stream, settings: Settings, name: str) -> bool:
    if len(stream.dated.t_ns):
        return True
    if getattr(settings.topics, stream.role.role) is not None:
        raise LogError(f"{name}: no usable message on {stream.role.topic}: {_reasons(stream) or 'it is empty'}")
    return False


def _one_epoch(streams: dict[str, _Stream]) -> dict[str, _Stream]:
    """Bring log-dated streams to the header's epoch when the two clocks are more than a minute apart."""
    offsets = [s.dated.offset_s for s in streams.values() if s.dated.clock == "header" and s.dated.offset_s is not None]
    if not offsets or abs(offsets[0]) < _MINUTE:
        return streams
    late_ns = np.int64(round(offsets[0] * 1e9))
    return {
        role: replace(s, dated=replace(s.dated, t_ns=s.dated.t_ns - late_ns)) if s.dated.clock == "log" else s
        for role, s in streams.items()
    }


def _start_ns(streams: Mapping[str, _Stream], log: Log) -> int:
    if "joints" in streams:
        return int(streams["joints"].dated.t_ns[0])
    return min((int(stream.dated.t_ns[0]) for stream in streams.values()), default=log.start_ns)


def _duration(streams: Mapping[str, _Stream], log: Log) -> float:
    if not streams:
        return (log.end_ns - log.start_ns) / 1e9
    first = min(int(stream.dated.t_ns[0]) for stream in streams.values())
    return (max(int(stream.dated.t_ns[-1]) for stream in streams.values()) - first) / 1e9


def _series(stream: _Stream | None, start_ns: int, unit: str) -> Series | None:
    if stream is None:
        return None
    return Series(seconds(stream.dated.t_ns, start_ns), stream.values, stream.names, unit, stream.log_ns)


def _health(stream: _Stream) -> Health:
    used = sum(stream.counts) - sum(stream.rejected.values())
    return Health(sum(stream.counts), used, stream.rejected, largest_gap(stream.dated.t_ns))


def _sidecar(path: Path, settings: Settings) -> video.Sidecar | None:
    said = settings.topics.camera
    return video.find(str(said), path, settings.video) if roles.is_video("camera", said) else None


def _said(sidecar: video.Sidecar | None, settings: Settings) -> dict[str, str]:
    return {"camera": str(settings.topics.camera)} if sidecar else {}


def _seen(sidecar: video.Sidecar | None) -> dict[str, Health]:
    return {"camera": Health(sidecar.frames, sidecar.frames, {}, 1 / sidecar.rate)} if sidecar else {}


def _frames(
    path: Path, strict: bool, stream: _Stream | None, sidecar: video.Sidecar | None, settings: Settings, start_ns: int
) -> Callable[[], Iterator[Frame]] | None:
    if sidecar is not None:
        start = settings.video.start
        first_s = 0.0 if start is None else (round(start * 1e9) - start_ns) / 1e9
        return video.frames(sidecar, first_s, start_ns)
    if stream is None:
        return None
    t_ns = stream.dated.t_ns
    return camera.frames(path, strict, stream.role.topics, stream.counts, stream.rows, t_ns, start_ns)


def _features(log: Log, start_ns: int) -> Features | None:
    if not any(topic.name.startswith(_OURS) for topic in log.topics):
        return None
    from .annotated import read_features

    return read_features(log, start_ns)


def _findings(log: Log, found: Mapping[str, Role], streams: Mapping[str, _Stream]) -> tuple[Finding, ...]:
    guess = [Finding("info", f"roles, ready for robot.toml: {roles.advice(found)}")] if found else []
    broken = [Finding("warning", f"{text}; not considered for any role") for text in roles.unreadable(log.topics)]
    empty = [
        Finding("warning", f"{role.role}: {role.topic} was guessed, but none of its messages can be used")
        for role in found.values()
        if role.role not in streams
    ]
    return (*guess, *broken, *empty, *(finding for stream in streams.values() for finding in _remarks(stream)))


def _remarks(stream: _Stream) -> Iterator[Finding]:
    dated, name = stream.dated, f"{stream.role.role} {stream.role.topic}"
    if dated.offset_s is not None:
        late = f"{dated.offset_s:.6g} s after the header's at the median, 5 to 95 % within {dated.spread_s:.3g} s"
        yield Finding("info", f"{name}: {dated.clock} time; log times are {late}")
    if dated.out_of_order:
        yield Finding("info", f"{name}: {dated.out_of_order} messages out of order were sorted")
    if stream.fallback:
        yield Finding("info", f"{name}: {stream.fallback} messages were decoded one by one")
    if stream.rejected:
        yield Finding("warning", f"{name}: rejected {_reasons(stream)} of {sum(stream.counts)} messages")


def _reasons(stream: _Stream) -> str:
    return ", ".join(f"{count} ({reason})" for reason, count in sorted(stream.rejected.items()))

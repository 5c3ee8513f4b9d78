"""Read a log into one Recording: roles, signals on
one clock, lazy frames, and a count of every message.
"""

import heapq
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import ConfigError, LogError
from ..logs.decode.cursor import Payload
from ..logs.formats import open_log, payload_views, without_images
from ..logs.images import messages, video_file
from ..logs.limits import Input
from ..logs.protocol import Log
from ..logs.storage.mmapped import is_mapped
from ..logs.topics import has_independent_poses
from ..settings import Settings
from ..sources import TableSource, TopicSource, track_names
from ..types import (
    Array,
    Batch,
    ConsumedFrames,
    Features,
    Finding,
    FrameConsumer,
    Frames,
    Health,
    LazyImage,
    LogFacts,
    RecordedCameras,
    RecordedSignals,
    Recording,
    Series,
    Topic,
)
from . import cameras, joint_topics, roles
from .clocks import largest_gap, seconds_since
from .dated_streams import Stream, joints_of, read_streams
from .joint_topics import common_unit, own_names, streams_of
from .roles import JOINTS, topic_name
from .saved_settings import is_ours, restore_settings
from .stream_findings import log_findings

_VIEW = "camera/"


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


def read_recording(
    path: Path,
    settings: Settings,
    strict: bool = False,
    consumer: Callable[[], FrameConsumer] | None = None,
) -> Recording:
    """Read the recording in a log of any format; a missing
    role is None. LogError, FormatError for unusable logs.

    `consumer` gets the first camera's images during
    reading, unless the log may already hold their tracks.
    """
    with open_log(path, strict, settings.input) as log:
        settings = restore_settings(log, settings)
        found = roles.assign_roles(log.topics, settings.topics, str(path), joints_of(log))
        to_be_seen = "camera" in found and not is_ours(log)
        with consumer() if consumer and to_be_seen else nullcontext() as frames:
            tap = FrameTap(log, found["camera"].topics, frames, settings.input) if frames else None
            streams, silent = read_streams(tap or without_images(log), found, settings, str(path))
        start_ns = _start_ns(streams, log)
        features = _read_own_features(log, start_ns)
        named, units = _read_named_tracks(log, path, settings, streams, start_ns, features)
        findings = (*log.findings, *silent, *log_findings(log, streams, settings), *units)
    signals = RecordedSignals(
        joints=merge_joint_series(streams, settings, start_ns, str(path)),
        skin=_series_of_stream(streams.get("skin"), start_ns, "0..1"),
        truth=_series_of_stream(streams.get("truth"), start_ns, "rad"),
        features=features,
        reference=_series_of_stream(streams.get("reference"), start_ns, "rad"),
        poses=any(
            has_independent_poses(stream.role.topics) for stream in joint_topics.streams_of(streams)
        ),
        tracks={name: track for name, (track, _) in named.items()},
    )
    films = _frames_of_topics(path, strict, streams, settings, start_ns)
    sidecars = _find_video_files(path, settings)
    start = settings.topics.start
    first_s = None if start is None else (round(start * 1e9) - start_ns) / 1e9
    films = {
        key: video_file.make_video_decoder(side, first_s, start_ns)
        for key, side in sidecars.items()
    } | films
    videos = {
        key: source
        for key, source in cameras.cameras_by_name(settings.topics).items()
        if key in sidecars
    }
    facts = LogFacts(
        name=path.name,
        format=log.format,
        topics=log.topics,
        roles={role: stream.role.path for role, stream in streams.items()} | videos,
        health={stream.role.topic: _health_of_stream(stream) for stream in streams.values()}
        | {
            one.video.path.name: Health(len(one.t), len(one.t), {}, one.largest_gap)
            for one in sidecars.values()
        },
        findings=findings,
        settings=settings,
        beside=joint_topics.unconfigured_joints(streams, settings),
        track_health={name: health for name, (_, health) in named.items()},
    )
    pictures = RecordedCameras(
        frames=films.get("camera"),
        views={
            key.removeprefix(_VIEW): film for key, film in films.items() if key.startswith(_VIEW)
        },
        consumed=_frames_consumed(tap, streams.get("camera"), start_ns),
    )
    return Recording(start_ns, _duration_of_streams(streams, log), facts, signals, pictures)


def _start_ns(streams: Mapping[str, Stream], log: Log) -> int:
    for stream in joint_topics.streams_of(streams)[:1]:
        return int(stream.timing.t_ns[0])
    return min((int(stream.timing.t_ns[0]) for stream in streams.values()), default=log.start_ns)


def _duration_of_streams(streams: Mapping[str, Stream], log: Log) -> float:
    if not streams:
        return (log.end_ns - log.start_ns) / 1e9
    first = min(int(stream.timing.t_ns[0]) for stream in streams.values())
    return (max(int(stream.timing.t_ns[-1]) for stream in streams.values()) - first) / 1e9


def _series_of_stream(stream: Stream | None, start_ns: int, unit: str) -> Series | None:
    if stream is None:
        return None
    return Series(
        seconds_since(stream.timing.t_ns, start_ns),
        stream.values,
        stream.names,
        unit,
        stream.log_ns,
    )


def _health_of_stream(stream: Stream) -> Health:
    used = sum(stream.counts) - sum(stream.rejected.values())
    return Health(sum(stream.counts), used, stream.rejected, largest_gap(stream.timing.t_ns))


def _find_video_files(path: Path, settings: Settings) -> dict[str, video_file.Sidecar]:
    declared = cameras.cameras_by_name(settings.topics).items()
    return {
        key: video_file.find_video_file(name, path, settings.topics.rate, settings.input)
        for key, name in declared
        if cameras.is_video_source("camera", name)
    }


def _frames_of_topics(
    path: Path, strict: bool, streams: Mapping[str, Stream], settings: Settings, start_ns: int
) -> dict[str, Frames]:
    """The images of every camera that is a topic, by its role."""
    limits = replace(settings.input, strict=strict)
    return {
        key: read_frames_lazily(
            path, limits, s.role.topics, s.counts, s.rows, s.timing.t_ns, start_ns
        )
        for key, s in streams.items()
        if s.role.role == "camera"
    }


def _read_own_features(log: Log, start_ns: int) -> Features | None:
    if not is_ours(log):
        return None
    from ..annotating.read_back import read_features

    return read_features(log, start_ns)


def _frames_consumed(
    tap: FrameTap | None, seen: Stream | None, start_ns: int
) -> ConsumedFrames | None:
    if tap is None or seen is None:
        return None
    return tap.consumed(seen.rows, seen.timing.t_ns, seen.log_ns, start_ns)


def _read_named_tracks(
    log: Log,
    path: Path,
    settings: Settings,
    streams: Mapping[str, Stream],
    start_ns: int,
    carried: Features | None,
) -> tuple[dict[str, tuple[Series, Health]], tuple[Finding, ...]]:
    """Tracks of topics and tables that [features] names, except those
    stored in the log by an earlier run; remarks on their units.
    """
    known = () if carried is None else carried.tracks
    rest = {
        name: source
        for name, source in settings.features.items()
        if not set(track_names(name, source)) & set(known)
    }
    if not any(isinstance(source, TopicSource | TableSource) for source in rest.values()):
        return {}, ()
    from . import topic_tracks

    asked = replace(settings, features=rest)
    timing = next((stream.timing for stream in joint_topics.streams_of(streams)), None)
    late_ns = (timing.offset_ns or 0) if timing is not None and timing.clock == "header" else 0
    found = dict(topic_tracks.read_topic_tracks(log, asked, start_ns, late_ns))
    found |= dict(
        topic_tracks.read_table_tracks(path, asked, start_ns, _duration_of_streams(streams, log))
    )
    findings = list[Finding]()
    for name, (track, health) in found.items():
        track, more = topic_tracks.points_in_mm(name, track)
        found[name] = track, health
        findings += more
    return found, tuple(findings)


def merge_joint_series(
    streams: Mapping[str, Stream], settings: Settings, start_ns: int, what: str
) -> Series | None:
    """The joints (N,M) rad of all topics at all of their times,
    NaN where a topic has no reading; None without joints.

    LogError when [body] joints names a missing joint.
    """
    found = streams_of(streams)
    _check_delay_topics(found, settings, what)
    if len(found) < 2:
        return None if not found else _series_of_single_topic(found[0], settings, start_ns)
    late = [round(1e9 * _delay_of_joints_s(stream, settings)) for stream in found]
    clocks = [stream.timing.t_ns - ns for stream, ns in zip(found, late, strict=True)]
    t_ns = np.unique(np.concatenate(clocks))
    every = [name for some in own_names(found) for name in some]
    values = np.full((len(t_ns), len(every)), np.nan)
    source_ns = np.zeros(len(t_ns), np.int64)
    column = 0
    for stream, clock in zip(reversed(found), reversed(clocks), strict=True):
        source_ns[np.searchsorted(t_ns, clock)] = stream.log_ns
    for stream, clock in zip(found, clocks, strict=True):
        width = stream.values.shape[1]
        values[np.searchsorted(t_ns, clock), column : column + width] = stream.values
        column += width
    whole = Series(
        seconds_since(t_ns, start_ns), values, tuple(every), common_unit(found), source_ns
    )
    return _select_joints_wanted(whole, settings.body.joints, what)


def _series_of_single_topic(stream: Stream, settings: Settings, start_ns: int) -> Series:
    """A single topic's joints; `delay` corrects the delay of this topic alone."""
    t_ns = stream.timing.t_ns - round(1e9 * _delay_of_joints_s(stream, settings))
    return Series(
        seconds_since(t_ns, start_ns), stream.values, stream.names, stream.unit, stream.log_ns
    )


def _check_delay_topics(found: Sequence[Stream], settings: Settings, what: str) -> None:
    """ConfigError for a delay of a missing joint topic."""
    given = settings.time.delay
    there = [f"{JOINTS}{topic_name(stream.role.topic)}" for stream in found]
    asked = [key for key in given if key.startswith(JOINTS)] if isinstance(given, Mapping) else []
    if unknown := [key for key in asked if key not in there]:
        raise ConfigError(
            f"{what}: [time] delay: {unknown[0]!r}; possible: {', '.join(there) or 'no joints'}"
        )


def _delay_of_joints_s(stream: Stream, settings: Settings) -> float:
    given = settings.time.delay
    return (
        given.get(f"{JOINTS}{topic_name(stream.role.topic)}", 0.0)
        if isinstance(given, Mapping)
        else 0.0
    )


def _select_joints_wanted(whole: Series, wanted: tuple[str, ...] | None, what: str) -> Series:
    if wanted is None:
        return whole
    if unknown := [name for name in wanted if name not in whole.names]:
        raise LogError(
            f"{what}: [body] joints names {unknown[0]!r}; the log has "
            f"{', '.join(sorted(whole.names))}"
        )
    columns: Array = np.array([whole.names.index(name) for name in wanted])
    return replace(whole, values=whole.values[:, columns], names=wanted)


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
    """A decoder for each message of a batch, on a copy of its bytes unless they stay valid."""
    keep = is_mapped(batch.data)
    return (
        partial(decode, payload if keep else bytes(payload)) for payload in payload_views(batch)
    )

"""Read a log into one Recording: roles, signals on
one clock, lazy frames, and a count of every message.
"""

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

from ..logs.formats import open_log, without_images
from ..logs.images import video_file
from ..logs.protocol import Log
from ..logs.topics import has_independent_poses
from ..settings import Settings
from ..sources import TableSource, TopicSource, track_names
from ..types import (
    ConsumedFrames,
    Features,
    Finding,
    FrameConsumer,
    Frames,
    Health,
    LogFacts,
    RecordedCameras,
    RecordedSignals,
    Recording,
    Series,
)
from . import cameras, joint_series, joint_topics, roles
from . import frames as camera
from .clocks import largest_gap, seconds_since
from .dated_streams import Stream, joints_of, read_streams
from .saved_settings import is_ours, restore_settings
from .stream_findings import log_findings

_VIEW = "camera/"


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
            tap = (
                camera.FrameTap(log, found["camera"].topics, frames, settings.input)
                if frames
                else None
            )
            streams, silent = read_streams(tap or without_images(log), found, settings, str(path))
        start_ns = _start_ns(streams, log)
        features = _read_own_features(log, start_ns)
        named, units = _read_named_tracks(log, path, settings, streams, start_ns, features)
        findings = (*log.findings, *silent, *log_findings(log, streams, settings), *units)
    sidecars = _find_video_files(path, settings)
    videos = {
        key: source
        for key, source in cameras.cameras_by_name(settings.topics).items()
        if key in sidecars
    }
    films = _frames_of_cameras(path, strict, streams, sidecars, settings, start_ns)
    facts = LogFacts(
        name=path.name,
        format=log.format,
        topics=log.topics,
        roles={role: stream.role.path for role, stream in streams.items()} | videos,
        health={stream.role.topic: _health_of_stream(stream) for stream in streams.values()}
        | _health_of_videos(sidecars),
        findings=findings,
        settings=settings,
        beside=joint_topics.unconfigured_joints(streams, settings),
        track_health={name: health for name, (_, health) in named.items()},
    )
    signals = RecordedSignals(
        joints=joint_series.merge_joint_series(streams, settings, start_ns, str(path)),
        skin=_series_of_stream(streams.get("skin"), start_ns, "0..1"),
        truth=_series_of_stream(streams.get("truth"), start_ns, "rad"),
        features=features,
        reference=_series_of_stream(streams.get("reference"), start_ns, "rad"),
        poses=any(
            has_independent_poses(stream.role.topics) for stream in joint_topics.streams_of(streams)
        ),
        tracks={name: track for name, (track, _) in named.items()},
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


def _health_of_videos(sidecars: Mapping[str, video_file.Sidecar]) -> dict[str, Health]:
    return {
        one.video.path.name: Health(len(one.t), len(one.t), {}, one.largest_gap)
        for one in sidecars.values()
    }


def _frames_of_cameras(
    path: Path,
    strict: bool,
    streams: Mapping[str, Stream],
    sidecars: Mapping[str, video_file.Sidecar],
    settings: Settings,
    start_ns: int,
) -> dict[str, Frames]:
    """The images of every camera, by its role."""
    start = settings.topics.start
    first_s = None if start is None else (round(start * 1e9) - start_ns) / 1e9
    limits = replace(settings.input, strict=strict)
    beside = {
        key: video_file.make_video_decoder(side, first_s, start_ns)
        for key, side in sidecars.items()
    }
    return beside | {
        key: camera.read_frames_lazily(
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
    tap: camera.FrameTap | None, seen: Stream | None, start_ns: int
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
    from . import space_points, table_tracks, topic_tracks

    asked = replace(settings, features=rest)
    timing = next((stream.timing for stream in joint_topics.streams_of(streams)), None)
    late_ns = (timing.offset_ns or 0) if timing is not None and timing.clock == "header" else 0
    found = dict(topic_tracks.read_topic_tracks(log, asked, start_ns, late_ns))
    found |= dict(
        table_tracks.read_table_tracks(path, asked, start_ns, _duration_of_streams(streams, log))
    )
    findings = list[Finding]()
    for name, (track, health) in found.items():
        track, more = space_points.points_in_mm(name, track)
        found[name] = track, health
        findings += more
    return found, tuple(findings)

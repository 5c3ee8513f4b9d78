"""A recording's images and skin as features: tracks, touches, strokes and their synchrony."""

from collections.abc import Iterable, Mapping

import numpy as np

from ..logs.protocol import Progress
from ..settings import Colour, Settings, list_configured_sources, list_sought_sources
from ..sources import ColourSource, PointSource, Source, board_points, track_names
from ..types import Board, Features, Finding, Frames, Health, Recording, Series, Stroke
from . import tracking
from .colours import colour_tracker
from .points import points
from .touch import detection, matching, strokes
from .tracking.candidates import Candidate, FeatureSurvey, survey_features
from .tracking.frame_search import FrameSearcher, SearchedFrames
from .tracking.unconfigured import find_alternative

__all__ = [
    "Candidate",
    "FeatureSurvey",
    "FrameSearcher",
    "find_alternative",
    "frame_searcher",
    "observe_recording",
    "rigid_groups",
    "survey_features",
]


def frame_searcher(settings: Settings, progress: Progress | None = None) -> FrameSearcher:
    """A consumer of the first camera's frames while the log is read, so that `observe_recording`
    reads them once. ConfigError.
    """
    features = list_configured_sources(settings)
    return colour_tracker.colour_searcher(
        _colours_of_features(features),
        progress,
        settings.colours.fast,
        tracking.make_trackers(features),
    )


def observe_recording(
    recording: Recording, settings: Settings, progress: Progress | None = None
) -> Features:
    """The features of a recording; `progress` gets the
    number of further images done. Raises ConfigError.

    Health is kept per track, and for "touch".
    """
    tracks, health, findings, size = _track_all_cameras(recording, settings, progress)
    # the search begins before it is known whether the log has a skin
    for name in (
        list_configured_sources(settings).keys()
        - list_sought_sources(settings, recording.signals.skin is not None).keys()
    ):
        tracks = {track: series for track, series in tracks.items() if track != name}
        health = {track: counts for track, counts in health.items() if track != name}
        findings = tuple(one for one in findings if not one.text.startswith(f"{name}: "))
    tracks = {**tracks, **recording.signals.tracks}
    health = {**health, **recording.facts.track_health}
    touches = None
    if recording.signals.skin is not None:
        touches, health["touch"], felt = detection.detect_touches(
            recording.signals.skin, settings.skin
        )
        findings += felt
    seen: tuple[Stroke, ...] = strokes.find_strokes(tracks["hand"]) if "hand" in tracks else ()
    pairs, more = matching.match_touches(
        touches or (), seen, clock_offset=settings.synchrony.clock_offset
    )
    boards = rigid_groups(list_configured_sources(settings), tracks)
    return Features(
        recording.signals.joints,
        tracks,
        touches,
        seen,
        pairs,
        health,
        findings + more,
        size,
        boards=boards,
    )


def rigid_groups(features: Mapping[str, Source], tracks: Iterable[str]) -> dict[str, Board]:
    """The rigid groups among the tracks, {feature or
    camera/feature: (track names, (K,3) m on the thing)}.
    """
    found: dict[str, Board] = {}
    cameras: dict[str, list[str]] = {}
    for track in tracks:
        cameras.setdefault(track.rpartition("/")[0], []).append(track)
    for camera, names in cameras.items():
        at = f"{camera}/" if camera else ""
        for name, source in features.items():
            points = dict(
                zip(track_names(f"{at}{name}", source), board_points(source) or (), strict=False)
            )
            if seen := tuple(track for track in points if track in names):
                found[f"{at}{name}"] = seen, np.array([points[track] for track in seen])
    return found


def _track_all_cameras(
    recording: Recording, settings: Settings, progress: Progress | None
) -> tuple[dict[str, Series], dict[str, Health], tuple[Finding, ...], tuple[int, int] | None]:
    """Tracks, health and findings of all cameras, and
    the first one's image width and height (px) if known.
    """
    if recording.cameras.frames is None:
        text = (
            "camera: none in this log; no tracks but those that topics and tables have"
            if recording.signals.tracks
            else "camera: none in this log; no tracks, no strokes"
        )
        return {}, {}, (Finding("info", text),), None
    features = list_configured_sources(settings)
    consumed = recording.cameras.consumed
    if consumed is not None and isinstance(consumed.by, FrameSearcher):
        seen = consumed.by.seen(consumed)
    else:
        seen = _search_camera(recording.cameras.frames, features, settings, progress)
    tracks, health, findings = _tracks_of_camera(
        seen, recording.cameras.frames, features, recording.signals.joints
    )
    given = {name: source for name, source in features.items() if isinstance(source, PointSource)}
    followed = points.track_points(recording.cameras.frames, given, recording.facts.name)
    more = tracking.series_of_tracked(followed, seen.t, seen.source_ns, np.arange(seen.t.size))
    tracks = tracks | more[0]
    health = health | more[1]
    for camera, frames in recording.cameras.views.items():
        # touches are compared with the first camera's hand
        beside = {f"{camera}/{name}": source for name, source in features.items() if name != "hand"}
        more = _tracks_of_camera(
            _search_camera(frames, beside, settings, progress),
            frames,
            beside,
            recording.signals.joints,
        )
        tracks = tracks | more[0]
        health = health | more[1]
        findings = findings + more[2]
    return tracks, health, findings, seen.size


def _search_camera(
    frames: Frames, features: Mapping[str, Source], settings: Settings, progress: Progress | None
) -> SearchedFrames:
    trackers = tracking.make_trackers(features)
    return colour_tracker.search_colours(
        frames, _colours_of_features(features), progress, settings.colours.fast, trackers
    )


def _tracks_of_camera(
    seen: SearchedFrames, frames: Frames, features: Mapping[str, Source], joints: Series | None
) -> colour_tracker.Tracks:
    """Tracks, health and findings of one camera."""
    tracks, health, findings = colour_tracker.colour_tracks(
        seen, frames, _colours_of_features(features), joints
    )
    more = tracking.series_of_tracked(seen.tracked, seen.t, seen.source_ns, seen.number)
    return tracks | more[0], health | more[1], findings + more[2]


def _colours_of_features(features: Mapping[str, Source]) -> dict[str, Colour]:
    return {
        name: source.colour for name, source in features.items() if isinstance(source, ColourSource)
    }

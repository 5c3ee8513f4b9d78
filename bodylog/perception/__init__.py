"""A recording's images and skin as features: tracks, touches, strokes and their synchrony."""

from collections.abc import Callable, Iterable, Iterator, Mapping

import numpy as np

from ..settings import Colour, Settings, sought, wanted
from ..sources import ColourSource, PointSource, Source, board_points, track_names
from ..types import Board, Features, Finding, Frame, Health, Recording, Series, Stroke
from . import tracking
from .colours import colour_tracker
from .points import points
from .touch import detection, matching, strokes
from .tracking.candidates import Candidate, Survey, survey
from .tracking.frame_search import FrameSearcher, Seen
from .tracking.unconfigured import find_alternative

__all__ = [
    "Candidate", "FrameSearcher", "Survey", "find_alternative", "observe", "rigid_groups", "searcher", "survey"
]  # fmt: skip

Progress = Callable[[int], None]
"""Called with the number of further images done."""
Frames = Callable[[], Iterator[Frame]]


def searcher(settings: Settings, progress: Progress | None = None) -> FrameSearcher:
    """A consumer of the first camera's frames while the log is read, so that `observe` reads them once. ConfigError."""
    features = wanted(settings)
    return colour_tracker.searcher(_colours(features), progress, settings.colours.fast, tracking.trackers(features))


def observe(recording: Recording, settings: Settings, progress: Progress | None = None) -> Features:
    """The features of a recording; `progress` gets the number of further images done. Raises ConfigError.

    Health is kept per track, and for "touch".
    """
    tracks, health, findings, size = _tracks(recording, settings, progress)
    # the search begins before it is known whether the log has a skin
    for name in wanted(settings).keys() - sought(settings, recording.skin is not None).keys():
        tracks = {track: series for track, series in tracks.items() if track != name}
        health = {track: counts for track, counts in health.items() if track != name}
        findings = tuple(one for one in findings if not one.text.startswith(f"{name}: "))
    tracks, health = {**tracks, **recording.tracks}, {**health, **recording.track_health}
    touches = None
    if recording.skin is not None:
        touches, health["touch"], felt = detection.touches(recording.skin, settings.skin)
        findings += felt
    seen: tuple[Stroke, ...] = strokes.strokes(tracks["hand"]) if "hand" in tracks else ()
    pairs, more = matching.match_touches(touches or (), seen, clock_offset=settings.synchrony.clock_offset)
    boards = rigid_groups(wanted(settings), tracks)
    return Features(recording.joints, tracks, touches, seen, pairs, health, findings + more, size, boards=boards)


def rigid_groups(features: Mapping[str, Source], tracks: Iterable[str]) -> dict[str, Board]:
    """The rigid groups among the tracks, {feature or camera/feature: (track names, (K,3) m on the thing)}."""
    found: dict[str, Board] = {}
    cameras: dict[str, list[str]] = {}
    for track in tracks:
        cameras.setdefault(track.rpartition("/")[0], []).append(track)
    for camera, names in cameras.items():
        at = f"{camera}/" if camera else ""
        for name, source in features.items():
            points = dict(zip(track_names(f"{at}{name}", source), board_points(source) or (), strict=False))
            if seen := tuple(track for track in points if track in names):
                found[f"{at}{name}"] = seen, np.array([points[track] for track in seen])
    return found


def _tracks(
    recording: Recording, settings: Settings, progress: Progress | None
) -> tuple[dict[str, Series], dict[str, Health], tuple[Finding, ...], tuple[int, int] | None]:
    """Tracks, health and findings of all cameras, and the first one's image width and height (px) if known."""
    if recording.frames is None:
        text = (
            "camera: none in this log; no tracks but those that topics and tables have"
            if recording.tracks
            else "camera: none in this log; no tracks, no strokes"
        )
        return {}, {}, (Finding("info", text),), None
    features, consumed = wanted(settings), recording.consumed
    if consumed is not None and isinstance(consumed.by, FrameSearcher):
        seen = consumed.by.seen(consumed)
    else:
        seen = _search(recording.frames, features, settings, progress)
    tracks, health, findings = _seen(seen, recording.frames, features, recording.joints)
    given = {name: source for name, source in features.items() if isinstance(source, PointSource)}
    followed = points.tracked(recording.frames, given, recording.name)
    more = tracking.series(followed, seen.t, seen.source_ns, np.arange(seen.t.size))
    tracks, health = tracks | more[0], health | more[1]
    for camera, frames in recording.views.items():
        # touches are compared with the first camera's hand
        beside = {f"{camera}/{name}": source for name, source in features.items() if name != "hand"}
        more = _seen(_search(frames, beside, settings, progress), frames, beside, recording.joints)
        tracks, health, findings = tracks | more[0], health | more[1], findings + more[2]
    return tracks, health, findings, seen.size


def _search(frames: Frames, features: Mapping[str, Source], settings: Settings, progress: Progress | None) -> Seen:
    trackers = tracking.trackers(features)
    return colour_tracker.search(frames, _colours(features), progress, settings.colours.fast, trackers)


def _seen(seen: Seen, frames: Frames, features: Mapping[str, Source], joints: Series | None) -> colour_tracker.Tracks:
    """Tracks, health and findings of one camera."""
    tracks, health, findings = colour_tracker.tracks(seen, frames, _colours(features), joints)
    more = tracking.series(seen.tracked, seen.t, seen.source_ns, seen.number)
    return tracks | more[0], health | more[1], findings + more[2]


def _colours(features: Mapping[str, Source]) -> dict[str, Colour]:
    return {name: source.colour for name, source in features.items() if isinstance(source, ColourSource)}

"""From a recording's signals and pictures to what they show: tracks, touches, strokes and their synchrony."""

from collections.abc import Callable, Mapping

from ..settings import Colour, Colours, Settings
from ..types import Features, Finding, Health, Recording, Series, Stroke
from . import colour, skin, strokes, synchrony
from .look import Looking

__all__ = ["Looking", "looking", "observe"]

Progress = Callable[[int], None]
"""Told how many more pictures are done."""


def looking(settings: Settings, progress: Progress | None = None) -> Looking:
    """To watch a log's first camera while the log is read, so that `observe` need not read it again. ConfigError."""
    return colour.looking(_wanted(settings.colours), progress, settings.colours.fast)


def observe(recording: Recording, settings: Settings, progress: Progress | None = None) -> Features:
    """Everything a recording shows; `progress` is told how many more pictures are done. Raises ConfigError.

    Health is kept per track, and for "touch".
    """
    tracks, health, findings, size = _tracks(recording, settings, progress)
    touches = None
    if recording.skin is not None:
        touches, health["touch"], felt = skin.touches(recording.skin, settings.skin)
        findings += felt
    seen: tuple[Stroke, ...] = strokes.strokes(tracks["hand"]) if "hand" in tracks else ()
    pairs, remarks = synchrony.judge(touches or (), seen, clock_offset=settings.synchrony.clock_offset)
    return Features(recording.joints, tracks, touches, seen, pairs, health, findings + remarks, size)


def _tracks(
    recording: Recording, settings: Settings, progress: Progress | None
) -> tuple[dict[str, Series], dict[str, Health], tuple[Finding, ...], tuple[int, int] | None]:
    """Tracks, health and findings of all cameras, and width and height (px) of the first one's pictures if known."""
    if recording.frames is None:
        return {}, {}, (Finding("info", "camera: none in this log; no tracks, no strokes"),), None
    wanted, watched, fast = _wanted(settings.colours), recording.watched, settings.colours.fast
    if watched is not None and isinstance(watched.by, Looking):
        seen = watched.by.seen(watched)
    else:
        seen = colour.look(recording.frames, wanted, progress, fast)
    tracks, health, findings = colour.tracks(seen, recording.frames, wanted)
    for camera, frames in recording.views.items():
        more = colour.track(frames, _beside(settings.colours, camera), progress, fast)
        tracks, health, findings = tracks | more[0], health | more[1], findings + more[2]
    return tracks, health, findings, seen.size


def _wanted(colours: Colours) -> Mapping[str, Colour]:
    return {"effector": colours.effector, "hand": colours.hand, **colours.shapes}


def _beside(colours: Colours, camera: str) -> Mapping[str, Colour]:
    """What a camera beside the first looks for: what is on the arm; touches are compared with the first's hand."""
    return {f"{camera}/{name}": colour for name, colour in _wanted(colours).items() if name != "hand"}

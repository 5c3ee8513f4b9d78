"""From a recording's signals and pictures to what they show: tracks, touches, strokes and their synchrony."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace

from ..errors import FormatError
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

    What an earlier run wrote into the log is taken over. Health is kept per track, and for "touch".
    """
    if recording.features is not None:
        return replace(recording.features, joints=recording.joints)
    tracks, health, findings = _tracks(recording, settings, progress)
    touches = None
    if recording.skin is not None:
        touches, health["touch"], felt = skin.touches(recording.skin, settings.skin)
        findings += felt
    seen: tuple[Stroke, ...] = strokes.strokes(tracks["hand"]) if "hand" in tracks else ()
    pairs, remarks = synchrony.judge(touches or (), seen, clock_offset=settings.synchrony.clock_offset)
    size = _size(recording)
    return Features(recording.joints, tracks, touches, seen, pairs, health, findings + remarks, size)


def _size(recording: Recording) -> tuple[int, int] | None:
    """Width and height (px) of the first picture; None where there is none that can be read."""
    first = next(recording.frames(), None) if recording.frames is not None else None
    with suppress(FormatError):
        return None if first is None else (int(first.image.shape[1]), int(first.image.shape[0]))
    return None


def _tracks(
    recording: Recording, settings: Settings, progress: Progress | None
) -> tuple[dict[str, Series], dict[str, Health], tuple[Finding, ...]]:
    if recording.frames is None:
        return {}, {}, (Finding("info", "camera: none in this log; no tracks, no strokes"),)
    fast = settings.colours.fast
    wanted, watched = _wanted(settings.colours), recording.watched
    if watched is not None and isinstance(watched.by, Looking):
        tracks, health, findings = colour.tracks(watched.by.seen(watched), recording.frames, wanted)
    else:
        tracks, health, findings = colour.track(recording.frames, wanted, progress, fast)
    for camera, frames in recording.views.items():
        more = colour.track(frames, _beside(settings.colours, camera), progress, fast)
        tracks, health, findings = tracks | more[0], health | more[1], findings + more[2]
    return tracks, health, findings


def _wanted(colours: Colours) -> Mapping[str, Colour]:
    return {"effector": colours.effector, "hand": colours.hand, **colours.shapes}


def _beside(colours: Colours, camera: str) -> Mapping[str, Colour]:
    """What a camera beside the first looks for: what is on the arm; touches are compared with the first's hand."""
    return {f"{camera}/{name}": colour for name, colour in _wanted(colours).items() if name != "hand"}

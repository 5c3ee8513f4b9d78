"""From a recording's signals and pictures to what they show: tracks, touches, strokes and their synchrony."""

from collections.abc import Callable, Mapping

from ..settings import Colour, Colours, Settings
from ..types import Features, Finding, Recording
from . import colour

__all__ = ["observe"]


def observe(recording: Recording, settings: Settings, progress: Callable[[int], None] | None = None) -> Features:
    """Everything a recording shows; `progress` is told how many more pictures are done. Raises ConfigError."""
    if recording.frames is None:
        findings: tuple[Finding, ...] = (Finding("info", "no camera: no tracks, no strokes"),)
        return Features(recording.joints, {}, None, (), (), {}, findings)
    tracks, health, findings = colour.track(recording.frames, _wanted(settings.colours), progress)
    return Features(recording.joints, tracks, None, (), (), health, findings)


def _wanted(colours: Colours) -> Mapping[str, Colour]:
    return {"effector": colours.effector, "hand": colours.hand, **colours.shapes}

"""Recordings made, or changed, by the names of the fields of their parts."""

from dataclasses import fields, replace
from typing import Any

from bodylog.types import LogFacts, RecordedCameras, RecordedSignals, Recording

PARTS = {"facts": LogFacts, "signals": RecordedSignals, "cameras": RecordedCameras}


def change_recording(recording: Recording, **values: Any) -> Recording:
    """The recording with other values of fields, whichever part they stand in."""
    for part, kind in PARTS.items():
        own = {one.name: values.pop(one.name) for one in fields(kind) if one.name in values}
        values[part] = replace(getattr(recording, part), **own)
    return replace(recording, **values)


def make_recording(name: str = "log", **values: Any) -> Recording:
    """A recording of an MCAP with these values, and nothing else."""
    empty = Recording(0, 0.0, LogFacts(name, "mcap"), RecordedSignals(), RecordedCameras())
    return change_recording(empty, **values)

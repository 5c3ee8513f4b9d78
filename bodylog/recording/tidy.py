"""Rewrite any recorded log as one tidy MCAP: standard
topic names, every message at its stream's time.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..annotating.annotate import add_topics
from ..annotating.image_messages import EMPTY, ImageMessage, Kind, image_messages
from ..annotating.messages import from_joints, from_skin, from_track, stamps_ns
from ..errors import LogError
from ..io.atomic_files import replace_atomically
from ..io.outputs import Output, guard_outputs
from ..logs.conversion.transcode import LIBRARY, PROFILE
from ..logs.formats import hash_log
from ..logs.mcap.prefix import NAME
from ..logs.mcap.verification import verify_message_count
from ..logs.mcap.writer import Contents, McapRecordWriter
from ..logs.protocol import Progress
from ..settings import Settings
from ..types import Finding, Outgoing, Recording, Series
from .dataset_metadata import kept_metadata, settings_of_episode
from .recording import read_recording

JOINTS = "/joint_states"
TRUTH = "/truth/joint_states"
SKIN = "/skin"
Window = tuple[float, float]
"""First and last time to keep (s)."""

ALWAYS: Window = (-np.inf, np.inf)


def write_tidy_log(
    path: Path,
    out: Path,
    settings: Settings,
    start: float | None = None,
    end: float | None = None,
    progress: Progress | None = None,
) -> tuple[Finding, ...]:
    """Write an MCAP `out` of the log's signals and images
    from `start` to `end` (s since its first joints).

    LogError when the log has neither signals nor images
    there, UsageError when `out` is also the input.
    """
    guard_outputs([path], [Output(out)])
    settings, further = settings_of_episode(path, settings)
    recording = read_recording(path, settings, settings.input.strict)
    earliest = -recording.start_ns / 1e9
    window = (earliest if start is None else max(start, earliest), np.inf if end is None else end)
    messages = [
        *tidy_messages(recording, window),
        *_within_window(further, recording.start_ns, window),
    ]
    with replace_atomically(out) as beside:
        with beside.open("wb") as stream:
            writer = McapRecordWriter(stream, Contents())
            writer.begin(PROFILE, LIBRARY)
            add_topics(
                writer,
                messages,
                kept_metadata(recording) | {one.topic: about for one, about in further},
            )
            unread: dict[str, list[str]] = {}
            found = image_messages(path, recording, unread)
            seen, early = _write_images(
                found, recording.start_ns, window, writer, kept_metadata(recording), progress
            )
            count = sum(len(o.log_ns) for o in messages) + seen
            if not count:
                lacking = f"no joints, skin, truth or images {_describe_window(start, end)}"
                raise LogError(f"{path}: {lacking}; type: bodylog info {path}")
            writer.about(NAME, {"source": path.name, "source_sha256": hash_log(path)})
            writer.finish()
        verify_message_count(beside, count, out)
    early += sum(int((series.t < earliest).sum()) for series in signals_by_role(recording).values())
    return (
        *recording.facts.findings,
        *_findings_on_unread(path, unread),
        *_finding_on_early_messages(path, early if start is None else 0),
    )


def _within_window(
    further: Sequence[tuple[Outgoing, Mapping[str, str]]], start_ns: int, window: Window
) -> Iterator[Outgoing]:
    """The messages of further topics within `window`."""
    for one, _ in further:
        t = (one.log_ns - start_ns) / 1e9
        rows = np.flatnonzero((t >= window[0]) & (t <= window[1]))
        yield replace(
            one, log_ns=one.log_ns[rows], offset=one.offset[rows], length=one.length[rows]
        )


def _findings_on_unread(path: Path, unread: Mapping[str, Sequence[str]]) -> Iterator[Finding]:
    """Images that contradict their definition, by topic."""
    for text in unread.get(EMPTY, ()):
        yield Finding("lost", f"{text}; they stand in it without bytes")
    for topic, reasons in unread.items():
        if topic == EMPTY:
            continue
        what = f"{len(reasons)} images cannot be read and are left out"
        yield Finding(
            "lost",
            f"{path}: {topic}: {what}, the first for this: {reasons[0].removeprefix(f'{topic}: ')}",
        )


def _finding_on_early_messages(path: Path, early: int) -> tuple[Finding, ...]:
    """A finding on messages before time 0, which an MCAP cannot store."""
    text = (
        "are before 0 s of the joints' clock and left out; for the log's clock: [time] joints = "
        '"log"'
    )
    return (Finding("warning", f"{path}: {early} messages {text}"),) if early else ()


def tidy_messages(recording: Recording, window: Window = ALWAYS) -> list[Outgoing]:
    """The recording's signals within `window` under tidy topic names, logged at their own times."""
    start_ns = recording.start_ns
    named = {
        role: cut_to_window(series, start_ns, window)
        for role, series in signals_by_role(recording).items()
    }
    out = [
        from_joints(topic, named[role], start_ns)
        for role, topic in _JOINTS.items()
        if role in named
    ]
    out += [from_skin(SKIN, named["skin"], start_ns)] if "skin" in named else []
    # tracks in a table of poses are measured, not bodylog's
    places = (
        recording.signals.features.tracks
        if recording.signals.poses and recording.signals.features is not None
        else {}
    )
    cuts = {name: cut_to_window(track, start_ns, window) for name, track in places.items()}
    return out + [from_track(name, track, start_ns, "") for name, track in cuts.items()]


_JOINTS = {"joints": JOINTS, "truth": TRUTH}


def signals_by_role(recording: Recording) -> dict[str, Series]:
    """The recording's signals by role."""
    found = {
        "joints": recording.signals.joints,
        "truth": recording.signals.truth,
        "skin": recording.signals.skin,
    }
    return {role: series for role, series in found.items() if series is not None}


def cut_to_window(series: Series, start_ns: int, window: Window) -> Series:
    """The rows within `window`, logged at their own times."""
    rows = (series.t >= window[0]) & (series.t <= window[1])
    t = series.t[rows]
    std = None if series.std is None else series.std[rows]
    return replace(
        series, t=t, values=series.values[rows], source_ns=stamps_ns(t, start_ns), std=std
    )


def _write_images(
    found: Iterable[ImageMessage],
    start_ns: int,
    window: Window,
    writer: McapRecordWriter,
    about: Mapping[str, Mapping[str, str]],
    progress: Progress | None,
) -> tuple[int, int]:
    """Write the images within `window`; returns how many, and how many came before it.

    about {camera's topic without /image…: metadata}.
    """
    channels: dict[Kind, int] = {}
    count = 0
    early = 0
    for image in found:
        if progress is not None:
            progress(1)
        if not window[0] <= image.t <= window[1]:
            early += image.t < window[0]
            continue
        if image.kind not in channels:
            kind = image.kind
            own = about.get(kind.topic.partition("/image")[0], {})
            channels[kind] = writer.topic(
                kind.topic, kind.type, "cdr", kind.definition, kind.form, own
            )
        log_ns = int(stamps_ns(np.array([image.t]), start_ns)[0])
        writer.add_message(channels[image.kind], count, log_ns, log_ns, image.payload)
        count += 1
    return count, early


def _describe_window(start: float | None, end: float | None) -> str:
    if start is None and end is None:
        return "in it"
    return (
        f"from {'the start' if start is None else f'{start} s'} to "
        f"{'the end' if end is None else f'{end} s'}"
    )

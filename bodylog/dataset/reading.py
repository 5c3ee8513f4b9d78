"""An episode as the checks see it: joints and actions as they are stored, and each camera's images seen once."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..delay_findings import LONGEST, MOST_FLOW_IMAGES, middle
from ..flow_findings import delay_by_flow, has_motion, see_cameras
from ..settings import Settings
from ..types import Array, Finding, Recording

if TYPE_CHECKING:
    from ..estimation.timing.flow_delay import FlowDelay
    from ..logs.datasets.episode_log import EpisodeLog, Signal
    from ..perception.surface.flow import GridFlow


@dataclass(frozen=True, eq=False)
class Stored:
    """Numbers as stored: t (N,) s since the first joint reading · values (N,K) · names (K,) · their unit."""

    t: Array
    values: Array
    names: tuple[str, ...]
    unit: str

    @property
    def step_s(self) -> float:
        """Median time between two rows (s); 0 of fewer than two."""
        return float(np.median(np.diff(self.t))) if len(self.t) > 1 else 0.0


@dataclass(frozen=True, eq=False)
class Film:
    """A camera's images: what was seen of them (None of fewer than two), and the delay by flow (None: not tried)."""

    seen: "GridFlow | None"
    delay: "FlowDelay | None"


@dataclass(frozen=True, eq=False)
class EpisodeReading:
    """One episode, read once.

    joints, action: None where the episode has none · films {camera: Film} · read: the same episode as estimation sees
    it, its joints in rad · rows: rows of its table, and `declared_rows`, those that the dataset lists (None: none) ·
    features {name: (dtype, values (N,K))}: all numbers of the table · findings of the readers.
    """

    joints: Stored | None
    action: Stored | None
    films: Mapping[str, Film]
    read: Recording
    rows: int
    declared_rows: int | None = None
    features: Mapping[str, Array] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()


def read_episode(log: Path, settings: Settings) -> EpisodeReading:
    """Read an episode; of a longer one than a minute the images of the middle minute. InputError if it is unusable."""
    from ..logs.datasets.episode_log import EpisodeLog
    from ..logs.formats import open_log
    from ..recording import recording

    whole = recording.read(log, settings, settings.input.strict)
    read = middle(whole, LONGEST, MOST_FLOW_IMAGES)
    by_flow = settings.time.delay != "off" and settings.kinematics.urdf is None and has_motion(read)
    films = {
        name: Film(seen, delay_by_flow(read, seen) if by_flow else None)
        for name, seen in see_cameras(read)
    }
    found = whole.joints
    joints = None if found is None else Stored(found.t, found.values, found.names, found.unit)
    reading = EpisodeReading(joints, None, films, whole, 0 if joints is None else len(joints.t))
    with open_log(log, settings.input.strict, settings.input) as opened:
        if isinstance(opened, EpisodeLog):
            reading = _with_stored_rows(reading, opened)
    return replace(reading, findings=tuple(dict.fromkeys((*whole.findings, *reading.findings))))


def _with_stored_rows(reading: EpisodeReading, log: "EpisodeLog") -> EpisodeReading:
    """The reading with the numbers of a dataset's episode as its table has them."""
    from ..logs.datasets.checks import length_texts
    from ..logs.datasets.episode_log import ACTION, FEATURE, JOINTS

    signals = {one.topic: one for one in log.signals}
    start_ns = reading.read.start_ns
    joints, action = (signals.get(topic) for topic in (JOINTS, ACTION))
    texts = [Finding("warning", f"{log.path}: {text}") for text in length_texts(log)]
    return replace(
        reading,
        joints=reading.joints if joints is None else _stored(joints, start_ns),
        action=None if action is None else _stored(action, start_ns),
        rows=max((len(one.ns) for one in log.signals), default=0),
        declared_rows=log.episode.length,
        features={one.metadata.get(FEATURE, one.topic): one.values for one in log.signals},
        findings=tuple(texts),
    )


def _stored(signal: "Signal", start_ns: int) -> Stored:
    from ..logs.joint_units import joint_unit

    known = joint_unit(signal.metadata, "rad")
    return Stored((signal.ns - start_ns) / 1e9, signal.values, signal.names, known.read)

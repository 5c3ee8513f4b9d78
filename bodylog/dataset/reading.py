"""An episode as the checks see it: joints and actions as they are stored, and each camera's images
seen once."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..delays.findings import MAX_DURATION_S, MOST_FLOW_IMAGES, middle_of_recording
from ..delays.flow import delay_by_flow, has_motion, name_moving_arm
from ..errors import LogError
from ..io.values import FARTHEST
from ..perception.surface.flow import measure_grid_flow
from ..recording.cameras import camera_name_of_source
from ..recording.role_hints import camera_topics
from ..settings import Settings
from ..types import Array, Finding, LazyImage, Recording

if TYPE_CHECKING:
    from ..delays.flow_delay import FlowDelay
    from ..logs.datasets.episode_log import EpisodeCamera, EpisodeLog, EpisodeSignal
    from ..perception.surface.flow import GridFlow


@dataclass(frozen=True, eq=False)
class StoredNumbers:
    """Numbers as stored, counts whose turn is known in degrees: t (N,) s since the first joint
    reading · values (N,K) · names (K,) · their unit."""

    t: Array
    values: Array
    names: tuple[str, ...]
    unit: str

    @property
    def step_s(self) -> float:
        """Median time between two rows (s); 0 of fewer than two."""
        return float(np.median(np.diff(self.t))) if len(self.t) > 1 else 0.0


@dataclass(frozen=True, eq=False)
class CameraFilm:
    """A camera's images: what was seen of them (None of fewer than two), and the delay by flow
    (None: not tried).

    arm: that of several arms whose joints move the picture (None: not known) · count: its images ·
    unreadable: those of them that cannot be decoded.
    """

    seen: "GridFlow | None"
    delay: "FlowDelay | None"
    count: int = 0
    unreadable: int = 0
    arm: str | None = None


@dataclass(frozen=True, eq=False)
class EpisodeReading:
    """One episode, read once.

    joints, action: None where the episode has none · films {camera: Film} · read: the same episode
    as estimation sees it, its joints in rad · rows: rows of its table, and `declared_rows`, those
    that the dataset lists (None: none) · features {name: (dtype, values (N,K))}: all numbers of the
    table · findings of the readers · robot: its type as the dataset names it, empty if it does not.
    """

    joints: StoredNumbers | None
    action: StoredNumbers | None
    films: Mapping[str, CameraFilm]
    read: Recording
    rows: int
    declared_rows: int | None = None
    features: Mapping[str, Array] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    robot: str = ""


def read_episode(log: Path, settings: Settings) -> EpisodeReading:
    """Read an episode; of a longer one than a minute the images of the middle minute. InputError if
    it is unusable."""
    from ..logs.datasets.episode_log import EpisodeLog
    from ..logs.formats import open_log
    from ..recording import recording

    with open_log(log, settings.input.strict, settings.input) as opened:
        episode = opened if isinstance(opened, EpisodeLog) else None
        topics = camera_topics(opened.topics)
    if episode is None and not settings.topics.cameras and topics:
        settings = replace(settings, topics=replace(settings.topics, camera=tuple(topics)))
    whole = recording.read_recording(log, settings, settings.input.strict)
    read = middle_of_recording(whole, MAX_DURATION_S, MOST_FLOW_IMAGES)
    films = _films_of_log(read) if episode is None else _films_of_episode(episode, read)
    if settings.time.delay != "off" and has_motion(read):
        films = {name: _with_delay(film, read) for name, film in films.items()}
    found = whole.signals.joints
    joints = (
        None if found is None else StoredNumbers(found.t, found.values, found.names, found.unit)
    )
    reading = EpisodeReading(joints, None, films, whole, 0 if joints is None else len(joints.t))
    if episode is not None:
        reading = _with_stored_rows(reading, episode)
    return replace(
        reading, findings=tuple(dict.fromkeys((*whole.facts.findings, *reading.findings)))
    )


def _with_delay(film: CameraFilm, read: Recording) -> CameraFilm:
    """The film with its delay against the joints, and the arm that moves its picture."""
    found = delay_by_flow(read, film.seen)
    if found is None or read.signals.joints is None:
        return film
    return replace(film, delay=found, arm=name_moving_arm(read.signals.joints.names, found))


def _films_of_log(read: Recording) -> dict[str, CameraFilm]:
    """What is seen of each camera of a log, by its topic's name."""
    first = (
        camera_name_of_source(read.facts.roles["camera"]) if "camera" in read.facts.roles else ""
    )
    found = {}
    for name, film in {"": read.cameras.frames, **read.cameras.views}.items():
        if film is not None:
            frames = _CountedFrames(film())
            seen = measure_grid_flow(frames)
            found[name or first] = CameraFilm(
                seen, None, frames.count, frames.count - _seen_count(seen)
            )
    return found


def _films_of_episode(log: "EpisodeLog", read: Recording) -> dict[str, CameraFilm]:
    """What is seen of each camera of a dataset's episode; images are decoded as grey ones, for no
    check needs more."""
    found = {}
    for camera in log.cameras.values():
        t = (camera.ns - read.start_ns) / 1e9
        spare = max(0.0, 0.5 * (read.duration_s - MAX_DURATION_S))
        frames = _CountedFrames(grey_frames(camera, t, spare, read.duration_s - spare))
        seen = measure_grid_flow(frames)
        found[camera_name_of_source(camera.topic)] = CameraFilm(
            seen, None, frames.count, frames.count - _seen_count(seen)
        )
    return found


def _seen_count(seen: "GridFlow | None") -> int:
    return 0 if seen is None else len(seen.brightness)


class _CountedFrames:
    """Frames, counted as they pass."""

    def __init__(self, frames: Iterator[LazyImage]) -> None:
        self._frames = frames
        self.count = 0

    def __iter__(self) -> Iterator[LazyImage]:
        """The frames."""
        for frame in self._frames:
            self.count += 1
            yield frame


def grey_frames(camera: "EpisodeCamera", t: Array, begin: float, end: float) -> Iterator[LazyImage]:
    """The frames of a camera at t (N,) s that lie from begin to end (s), as grey images where these
    cost less."""
    read = camera.read if camera.read_grey is None else camera.read_grey
    for number, image in read():
        at = float(t[number])
        if begin <= at <= end:
            yield LazyImage(at, int(camera.ns[number]), partial(_decode_image, image), False)


def _decode_image(image: "Array | bytes | None", _shrink: int) -> Array:
    """An image as a camera of an episode gives it; LogError for one that cannot be decoded."""
    import cv2

    if isinstance(image, bytes):
        decoded = (
            cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_GRAYSCALE) if image else None
        )
        image = None if decoded is None else np.asarray(decoded)
    if image is None:
        raise LogError("the image cannot be decoded")
    return image


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
        joints=reading.joints if joints is None else _stored_numbers(joints, start_ns),
        action=None if action is None else _stored_numbers(action, start_ns),
        rows=max((len(one.ns) for one in log.signals), default=0),
        declared_rows=log.episode.length,
        features={one.metadata.get(FEATURE, one.topic): one.values for one in log.signals},
        findings=tuple(texts),
        robot="" if joints is None else joints.metadata.get("bodylog.robot", ""),
    )


def _stored_numbers(signal: "EpisodeSignal", start_ns: int) -> StoredNumbers:
    from ..logs.joint_units import joint_unit

    known = joint_unit(signal.metadata, "rad")
    t = (signal.ns - start_ns) / 1e9
    values = signal.values
    shown = known.read
    if known.read == "counts" and known.unit == "rad":
        values = np.rad2deg((values - known.zero) * known.factor)
        shown = "deg"
    credible = np.where(np.abs(values) <= FARTHEST, values, np.nan)  # as logs are read
    return StoredNumbers(t, credible, signal.names, shown)

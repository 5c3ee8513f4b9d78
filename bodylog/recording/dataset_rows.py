"""A recorded log as rows of a dataset: one row per image
of the first camera, with the nearest other readings.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from ..annotating.messages import stamps_ns
from ..errors import BodylogError, FormatError, LogError
from ..logs.datasets.episode_log import DTYPE, FEATURE, JOINT_STATE, TEXT, VECTOR
from ..logs.formats import open_log
from ..logs.joint_units import SOURCE_UNIT, UNIT, joint_unit
from ..logs.library import OpenLog
from ..logs.topics import PREFIX
from ..settings import Settings
from ..types import Array, Finding, Frames, LazyImage, Recording, Topic
from . import dataset_metadata, roles
from .cameras import camera_name_of_source
from .recording import read_recording

STATE = "observation.state"
ACTION = "action"
IMAGES = "observation.images."


@dataclass(frozen=True, eq=False)
class Feature:
    """Numbers of a dataset: values (N,K), names (K,), own
    times ns (N,) int64, declared dtype and unit, "" if none.
    """

    values: Array
    names: tuple[str, ...]
    ns: Array
    dtype: str = ""
    unit: str = ""


@dataclass(frozen=True, eq=False)
class DatasetCamera:
    """A camera of a dataset: size (width, height) px, own
    times ns (N,) int64, and a function for its row images.

    `unread`: rows without a readable image, which repeat
    the previous one; known once images were read.
    """

    size: tuple[int, int]
    ns: Array
    images: Callable[[], Iterator[Array]]
    unread: set[int] = field(default_factory=set)


@dataclass(frozen=True, eq=False)
class DatasetRows:
    """An episode to write: times of the rows ns (N,) int64,
    features and cameras by name, task, rate (Hz), robot.
    """

    ns: Array
    features: Mapping[str, Feature]
    views: Mapping[str, DatasetCamera]
    task: str
    fps: float
    robot: str | None
    findings: Sequence[Finding]


def read_dataset_rows(
    path: Path,
    settings: Settings,
    task: str | None = None,
    start: float | None = None,
    end: float | None = None,
) -> DatasetRows:
    """The rows of a log from `start` to `end` (s since
    its first joints); LogError without joints and images.
    """
    recording = read_recording(path, _every_camera(path, settings), settings.input.strict)
    joints = dataset_metadata.joints_metadata(recording)
    findings = list(recording.facts.findings)
    features, text = _signal_features(path, recording, joints, findings)
    films = {} if recording.cameras.frames is None else {"": recording.cameras.frames}
    films |= dict(recording.cameras.views)
    taken = {
        name: np.array([recording.start_ns + round(one.t * 1e9) for one in film()], np.int64)
        for name, film in films.items()
    }
    ns = _choose_row_times(
        path,
        [*taken.values(), *(one.ns for one in features.values())],
        recording.start_ns,
        start,
        end,
    )
    views = {
        _camera_feature_name(name, recording): view
        for name in films
        if (view := _view_of_camera(path, name, films[name], taken[name], ns, findings)) is not None
    }
    at_rows = {name: _feature_at_rows(one, ns) for name, one in features.items()}
    findings += _findings_on_time_apart(path, {**at_rows, **views}, ns)
    task = text if task is None else task
    return DatasetRows(
        ns,
        at_rows,
        views,
        task,
        _rows_per_second(joints, ns),
        joints.get("bodylog.robot"),
        findings,
    )


def count_row_images(path: Path, settings: Settings) -> int:
    """Images of a whole log's rows: one of each camera
    for each of the first one's; 0 without an image topic.
    """
    names = _every_camera(path, settings).topics.cameras
    with open_log(path, settings.input.strict, settings.input) as log:
        first = sum(topic.messages for topic in log.topics if names and topic.name == names[0])
    return len(names) * first


def nearest_indices(of: Array, at: Array) -> Array:
    """Index of the time in `of` (n,), ascending, nearest to
    each of `at` (m,); the earlier one of two equally near.
    """
    after = np.minimum(np.searchsorted(of, at), len(of) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(at - of[before]) <= np.abs(of[after] - at), before, after)


def _every_camera(path: Path, settings: Settings) -> Settings:
    """The settings; if they name no camera, with all of the log's."""
    if settings.topics.camera is not None:
        return settings
    with open_log(path, settings.input.strict, settings.input) as log:
        some = {
            topic.name for topic in log.topics if roles.is_raw(topic) and _is_readable_camera(topic)
        }
    return replace(settings, topics=replace(settings.topics, camera=tuple(sorted(some)) or None))


def _is_readable_camera(topic: Topic) -> bool:
    return roles.camera_rank(topic) is not None and roles.problem_with_definition(topic) is None


def _signal_features(
    path: Path, recording: Recording, about: Mapping[str, str], findings: list[Finding]
) -> tuple[dict[str, Feature], str]:
    """Signals of a log by the names of their features, and its first task."""
    found: dict[str, Feature] = {}
    if recording.signals.skin is not None:
        skin = recording.signals.skin
        found["observation.skin"] = Feature(
            skin.values, skin.names, stamps_ns(skin.t, recording.start_ns)
        )
    paths = list(recording.facts.roles.values())
    left = list[str]()
    task = ""
    used = {
        t.name
        for t in recording.facts.topics
        for path in paths
        if path == t.name or path.startswith(f"{t.name}.")
    }
    with OpenLog(path) as log:
        if recording.signals.joints is not None and len(recording.signals.joints.t):
            found = {about.get(FEATURE, STATE): _joint_feature(log, recording, about)} | found
        for topic in recording.facts.topics:
            if (
                topic.name in used
                or topic.name.startswith(PREFIX)
                or not topic.messages
                or _is_readable_camera(topic)
            ):
                continue
            if topic.type == TEXT and topic.metadata.get(FEATURE) == "task":
                task = str(next(iter(log.messages([topic.name]))).value.data)
            elif (one := _number_feature(log, topic)) is not None:
                found.setdefault(topic.metadata.get(FEATURE) or _feature_name(topic, found), one)
            else:
                left.append(topic.name)
    if left:
        findings.append(
            Finding(
                "info", f"{path}: topics that the dataset leaves out: {', '.join(sorted(left))}"
            )
        )
    return found, task


def _joint_feature(log: OpenLog, recording: Recording, about: Mapping[str, str]) -> Feature:
    """The joints as in their topic if it is the only one and is read whole; else as converted."""
    joints = recording.signals.joints
    assert joints is not None
    ns = stamps_ns(joints.t, recording.start_ns)
    names = joints.names
    topic = next(
        (one for one in recording.facts.topics if one.name == recording.facts.roles.get("joints")),
        None,
    )
    own = None if topic is None else _number_feature(log, topic)
    values = joints.values
    unit = joints.unit
    if own is not None and own.names == names and np.array_equal(own.ns, ns):
        values = own.values
        unit = about.get(UNIT, "") if topic is None else topic.metadata.get(UNIT, joints.unit)
    if unit == "rad" and about.get(SOURCE_UNIT) == "deg":
        values = np.rad2deg(values)
        unit = "deg"
    elif unit == "rad" and about.get(SOURCE_UNIT) == "counts":
        known = joint_unit({**about, UNIT: "counts"}, "rad")
        if known.unit == "rad":
            values = np.rint(values / known.factor + known.zero)
            unit = "counts"
    return Feature(values, names, ns, about.get(DTYPE, ""), unit)


def _number_feature(log: OpenLog, topic: Topic) -> Feature | None:
    """The joints or numbers of a topic, in time order;
    None for another type, or for changing names.
    """
    fields = {JOINT_STATE: ("name", "position"), VECTOR: ("names", "data")}.get(topic.type)
    if fields is None:
        return None
    try:
        table = log.read({topic.name: ["header.stamp", *fields]})[topic.name]
    except BodylogError:
        return None
    names, values, ns = (table[name] for name in (*fields, "header.stamp"))
    if (
        values.ndim != 2
        or not values.size
        or names.shape != values.shape
        or (names != names[0]).any()
    ):
        return None
    order = np.argsort(ns, kind="stable")
    about = topic.metadata
    texts = tuple(map(str, names[0]))
    return Feature(
        np.asarray(values, float)[order],
        texts,
        ns[order],
        about.get(DTYPE, ""),
        about.get(UNIT, ""),
    )


def _feature_name(topic: Topic, taken: Mapping[str, Feature]) -> str:
    """`action` for the first joint commands, else observation.TOPIC."""
    if topic.type == JOINT_STATE and roles.is_command(topic) and ACTION not in taken:
        return ACTION
    return f"observation.{topic.name.strip('/').replace('/', '.')}"


def _choose_row_times(
    path: Path, streams: Sequence[Array], start_ns: int, start: float | None, end: float | None
) -> Array:
    """The times of the rows: those of the first stream that is not empty."""
    first = next((ns for ns in streams if len(ns)), None)
    if first is None:
        raise LogError(f"{path}: neither joints nor images for rows; type: bodylog info {path}")
    ns = np.unique(first)
    t = (ns - start_ns) / 1e9
    within = (t >= (-np.inf if start is None else start)) & (t <= (np.inf if end is None else end))
    if not within.any():
        raise LogError(
            f"{path}: no rows in the requested time; they exist from {t[0]:.3f} to {t[-1]:.3f} s"
        )
    return np.asarray(ns[within])


def _feature_at_rows(one: Feature, ns: Array) -> Feature:
    which = nearest_indices(one.ns, ns)
    return replace(one, values=one.values[which], ns=one.ns[which])


def _camera_feature_name(name: str, recording: Recording) -> str:
    """The name of a camera's feature: as in the log's dataset, else from its topic."""
    known = dataset_metadata.role_metadata(recording, f"camera/{name}" if name else "camera").get(
        FEATURE
    )
    return (
        known
        or f"{IMAGES}{(name or camera_name_of_source(recording.facts.roles['camera'])).replace('/', '.')}"
    )


def _view_of_camera(
    path: Path, name: str, film: Frames, taken: Array, ns: Array, findings: list[Finding]
) -> DatasetCamera | None:
    """A camera with an image for each row; None, and a finding, without readable images."""
    size = next((found for frame in film() if (found := _frame_size(frame)) is not None), None)
    if size is None:
        findings.append(
            Finding(
                "lost", f"{path}: camera {name or 'camera'}: no image can be read; it is left out"
            )
        )
        return None
    which = nearest_indices(taken, ns)
    unread = set[int]()
    return DatasetCamera(
        size, taken[which], partial(_images_of_rows, film, which, size, unread), unread
    )


def _frame_size(frame: LazyImage) -> tuple[int, int] | None:
    try:
        height, width = frame.decode(1).shape[:2]
    except FormatError:
        return None
    return width, height


def _images_of_rows(
    film: Frames, which: Array, size: tuple[int, int], unread: set[int]
) -> Iterator[Array]:
    """An image for each row; an unreadable one repeats the previous image, black for the first."""
    frames = enumerate(film())
    number = -1
    image: Array = np.zeros((size[1], size[0], 3), np.uint8)
    for row, wanted in enumerate(which.tolist()):
        if number < wanted:
            number, frame = next((k, one) for k, one in frames if k == wanted)
            try:
                image = frame.image
                sound = True
            except FormatError:
                sound = False
        unread.update(() if sound else (row,))
        yield image


def _findings_on_time_apart(
    path: Path, streams: Mapping[str, Feature | DatasetCamera], ns: Array
) -> Iterator[Finding]:
    """Streams whose times differ from the rows'."""
    far = {name: float(np.abs(one.ns - ns).max()) / 1e9 for name, one in streams.items()}
    off = [f"{name} up to {distance:.3g} s" for name, distance in far.items() if distance > 0]
    if off:
        text = (
            "rows are the first camera's images, or else the joints; the nearest reading of "
            "others is taken"
        )
        yield Finding(
            "info",
            f"{path}: {text}: {', '.join(off)} apart; their own times are kept in NAME.stamp_ns",
        )


def _rows_per_second(about: Mapping[str, str], ns: Array) -> float:
    """Rows per second: as the dataset declares, else their median, to four digits."""
    try:
        declared = float(about.get("bodylog.fps", ""))
    except ValueError:
        declared = 0.0
    if 0 < declared < 1e5:
        return declared
    return float(f"{1e9 / float(np.median(np.diff(ns))):.4g}") if len(ns) > 1 else 1.0

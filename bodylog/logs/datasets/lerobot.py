"""A LeRobot episode as a log: state, action and other
features as topics, cameras from videos or tables.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, LogError
from ...io import episodes
from ...io.values import log_times_ns
from ..limits import LIMITS, Input
from ..records import Array, Finding
from ..topics import escape_topic_name
from . import parquet, video
from .declared import BOOKKEEPING, NUMBERS, compare_columns, compare_row_rate, compare_video
from .episode_log import (
    ACTION,
    DTYPE,
    EPOCH_NS,
    FEATURE,
    JOINT_STATE,
    JOINTS,
    VECTOR,
    Episode,
    EpisodeCamera,
    EpisodeLog,
    EpisodeSignal,
    Item,
    Texts,
    is_named_depth,
)
from .lerobot_layout import (
    EPISODE_TABLES,
    EPISODES,
    TASK_TABLE,
    TASKS,
    DatasetLayout,
    EpisodePart,
    read_dataset_layout,
    read_task_texts,
)
from .units import guess_joint_unit

_STATE = ("observation.state", "observation.qpos", "observation.joint_positions", "state")
_ACTIONS = ("action", "actions")
_STAMP = ".stamp_ns"
"""Suffix of features that hold the times of another
feature (int64, ns), as `convert` writes them.
"""
_MOST_WIDE = 100_000
_SPARSE = 1.5
"""Intervals between a video's frames from which rows are further apart than these."""
_EXACT_S = 1e-3
"""s within which rows at a lower rate have a frame at their very time."""


def open_lerobot(path: Path, strict: bool = False, limits: Input = LIMITS) -> EpisodeLog:
    """Open an episode of a LeRobot folder: DATASET#N is number N, DATASET the first one."""
    folder, number = episodes.split_episode_name(path)
    known = read_dataset_layout(folder)
    findings = list[Finding]()
    if number is None:
        there = known.present()
        if not there:
            raise LogError(_describe_missing_tables(known))
        number = there[0]
        if len(there) > 1:
            some = (
                f"episode {number}, the first of {_format_number_ranges(there)}; for another, "
                f"type: --episode {there[1]}"
            )
            findings.append(Finding("info", some))
    if not known.holds(number):
        raise LogError(
            f"{folder}: no episode {number}; possible: "
            f"{_format_number_ranges(known.present()) or 'none'}"
        )
    return EpisodeLog(path, _read_lerobot_episode(known, number, findings, limits), strict)


def _describe_missing_tables(known: DatasetLayout) -> str:
    """Why a dataset has no episode with an existing table."""
    if not known.rows:
        listing = known.folder / (EPISODES if known.one_file_each else EPISODE_TABLES)
        return f"{listing}: it lists no episodes; is the dataset downloaded completely?"
    expected = known.table(min(known.rows))
    return (
        f"{known.folder}: none of the {len(known.rows)} episodes it lists has an existing table; "
        f"by data_path in info.json the first is {expected}"
    )


def lerobot_episode_files(folder: Path, number: int | None) -> tuple[Path, ...]:
    """The existing files of an episode (None: the first)."""
    known = read_dataset_layout(folder)
    number = next(filter(known.holds, sorted(known.rows)), 0) if number is None else number
    cameras = [name for name, about in known.features.items() if about.get("dtype") == "video"]
    found = [folder / "meta" / "info.json"]
    if number in known.rows:
        found += [known.table(number), *(known.video(number, name).path for name in cameras)]
    return tuple(dict.fromkeys(path for path in found if path.is_file()))


def _format_number_ranges(numbers: Sequence[int]) -> str:
    """Format numbers as 0 to 24, or 0, 1, 7."""
    if len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1:
        return f"{numbers[0]} to {numbers[-1]}"
    return ", ".join(map(str, numbers[:12])) + (
        f" and {len(numbers) - 12} more" if len(numbers) > 12 else ""
    )


def _read_lerobot_episode(
    known: DatasetLayout, number: int, findings: list[Finding], limits: Input
) -> Episode:
    table = known.table(number)
    where = parquet.find_row_runs(table, "episode_index", number, limits)
    if not where:
        raise LogError(f"{table}: no rows of episode {number}")
    if number in known.repeated:
        listing = EPISODES if known.one_file_each else EPISODE_TABLES
        text = f"{listing} lists episode {number} more than once; its last entry is taken"
        findings.append(Finding("warning", text))
    columns = parquet.list_column_types(table)
    needed = (*_STATE, *_ACTIONS)
    findings += compare_columns(known.features, columns, needed)
    numbers = [name for name, about in known.features.items() if about.get("dtype") in NUMBERS]
    wanted = [name for name in numbers if name not in BOOKKEEPING and not name.endswith(_STAMP)]
    found = parquet.read_number_columns(
        table, list(dict.fromkeys([*wanted, *BOOKKEEPING])), where, limits
    )
    count = sum(end - first for first, end in where)
    named = [f"{name}{_STAMP}" for name in known.features if f"{name}{_STAMP}" in known.features]
    stamps = {name: parquet.read_integer_column(table, name, where, limits) for name in named}
    ns = _find_row_times(stamps, found.get("timestamp"), count, known.fps, findings)
    if not named:
        findings += compare_row_rate(ns / 1e9, known.fps)
    streams: list[EpisodeSignal | Texts | EpisodeCamera] = []
    for name in wanted:
        streams += _build_feature_signal(
            name, known, found.get(name), _feature_times(stamps, name, ns), findings
        )
    streams += _task_changes(known, found, ns, findings)
    for name, about in known.features.items():
        if _lacks_image_column(name, about, columns):
            text = f"{name}: info.json says dtype image, {table} has no such column"
            findings.append(Finding("lost", f"{text}; possible: video"))
        elif about.get("dtype") in ("video", "image"):
            own = _feature_times(stamps, name, ns)
            shown = _video_times(found.get("timestamp"), ns)
            begin_s = _begin(found.get("timestamp"))
            streams += _read_lerobot_camera(
                name, known, number, own, shown, begin_s, where, findings, limits
            )
    length = known.rows[number].get("length")
    return Episode(
        f"lerobot {known.version}", streams, findings, length if isinstance(length, int) else None
    )


def _find_row_times(
    stamps: Mapping[str, Array | None],
    t: Array | None,
    count: int,
    fps: float,
    findings: list[Finding],
) -> Array:
    """Times of the rows (N,) int64 ns: the first stamps,
    else `timestamp` (s), else row numbers at the rate.
    """
    own = [ns for ns in stamps.values() if ns is not None]
    if own:
        return log_times_ns(own[0])
    if t is None or t.shape[1] != 1 or not np.isfinite(t).all() or np.abs(t).max(initial=0) > 9e9:
        findings.append(
            Finding("warning", f"no timestamp dates every row; rows are dated at {fps:g} Hz")
        )
        t = np.arange(count)[:, None] / fps
    if still := int((np.diff(t[:, 0]) <= 0).sum()):
        findings.append(Finding("warning", f"timestamp does not rise in {still} of {count} rows"))
    return log_times_ns(EPOCH_NS + np.rint(t[:, 0] * 1e9).astype(np.int64))


def _feature_times(stamps: Mapping[str, Array | None], name: str, ns: Array) -> Array:
    """The feature's own times if the dataset has them, else the rows'."""
    own = stamps.get(f"{name}{_STAMP}")
    return ns if own is None else log_times_ns(own)


def _video_times(t: Array | None, ns: Array) -> Array:
    """Times (N,) s at which a video shows the rows: `timestamp`,
    which need not be their stamps; else their times.
    """
    if t is not None and t.shape == (len(ns), 1) and np.isfinite(t).all():
        return np.asarray(t[:, 0] - t[:1, 0])
    return np.asarray((ns - ns[:1]) / 1e9)


def _begin(t: Array | None) -> float:
    """The first row's `timestamp`, at which LeRobot looks for its image in the video (s)."""
    known = t is not None and t.shape[1:] == (1,) and len(t) > 0 and bool(np.isfinite(t[0, 0]))
    return float(t[0, 0]) if known and t is not None else 0.0


def _build_feature_signal(
    name: str, known: DatasetLayout, values: Array | None, ns: Array, findings: list[Finding]
) -> Iterator[EpisodeSignal]:
    about = known.features[name]
    if values is None or not values.shape[1]:
        findings.append(
            Finding("lost", f"{name}: info.json declares it, the table holds no such numbers")
        )
        return
    if values.shape[1] > _MOST_WIDE:
        findings.append(
            Finding(
                "lost", f"{name}: {values.shape[1]} numbers in a row; at most {_MOST_WIDE} are read"
            )
        )
        return
    width = _declared_width(about.get("shape"))
    if width != values.shape[1]:
        text = f"{name}: info.json declares {width} numbers, the table holds {values.shape[1]}"
        findings.append(Finding("warning", text))
    listed = _flatten_names(about.get("names"))
    names = _declared_names(listed, values.shape[1])
    if len(listed) > 1 and len(listed) != values.shape[1]:
        text = f"{name}: info.json lists {len(listed)} names of {values.shape[1]} numbers"
        findings.append(Finding("warning", f"{text}; they are called by their numbers"))
    metadata = {FEATURE: name, DTYPE: str(about["dtype"]), **_robot_metadata(known, name)}
    state = next((one for one in _STATE if known.features.get(one)), None)
    topic = f"/{escape_topic_name(name.replace('.', '/'))}"
    kind = VECTOR
    if name in (state, *_ACTIONS):
        topic = JOINTS if name == state else ACTION
        kind = JOINT_STATE
        of = guess_joint_unit(about, names, values, str(known.info.get("robot_type")))
        metadata |= of.metadata
        findings += [Finding(*of.remark)] if name == state else []
    yield EpisodeSignal(topic, kind, names, values, ns, metadata)


def _declared_width(shape: Any) -> int | str:
    """The numbers of a row by its declared shape: one without
    a shape; the shape's text if it is no list of sizes.
    """
    if not shape:
        return 1
    if not isinstance(shape, list) or not all(isinstance(side, int) for side in shape):
        return f"{shape!r:.40}"
    return math.prod(shape)


def _robot_metadata(known: DatasetLayout, name: str) -> dict[str, str]:
    """The joints' metadata from the dataset: rate and robot."""
    if name not in _STATE:
        return {}
    robot = known.info.get("robot_type")
    return {"bodylog.fps": f"{known.fps:g}"} | (
        {"bodylog.robot": robot} if isinstance(robot, str) else {}
    )


def _flatten_names(declared: Any) -> list[Any]:
    """Names as a list: of a list, or of the values of a mapping ({"motors": [...]}).

    Some datasets nest the list in another, [[...]].
    """
    while isinstance(declared, dict | list) and len(declared) == 1:
        only = declared[0] if isinstance(declared, list) else next(iter(declared.values()))
        if isinstance(only, str):
            break
        declared = only
    if isinstance(declared, dict):
        declared = [
            text
            for part in declared.values()
            for text in (part if isinstance(part, list) else [part])
        ]
    return declared if isinstance(declared, list) else []


def _declared_names(listed: Sequence[Any], count: int) -> tuple[str, ...]:
    """The names of `count` numbers where so many are listed; else their indices."""
    if len(listed) == count and all(isinstance(text, str) for text in listed):
        names = tuple(text.encode(errors="replace").decode().replace("\0", "") for text in listed)
        if len(set(names)) == count and all(names):
            return names
    return tuple(map(str, range(count)))


def _task_changes(
    known: DatasetLayout, found: Mapping[str, Array | None], ns: Array, findings: list[Finding]
) -> Iterator[Texts]:
    """The task at its beginning and at each change; a finding for rows of a task without text."""
    index = found.get("task_index")
    texts = read_task_texts(known)
    if not texts or not len(ns):
        return
    if index is None or index.shape[1] != 1:
        index = np.zeros((len(ns), 1))
    begins = np.flatnonzero(np.concatenate([[True], np.diff(index[:, 0]) != 0]))
    rows = [row for row in begins.tolist() if index[row, 0] in texts]
    unknown = sorted({float(index[row, 0]) for row in begins.tolist()}.difference(texts))
    if unknown:
        listing = TASKS if known.one_file_each else TASK_TABLE
        shown = ", ".join(f"{one:g}" for one in unknown[:5])
        listed = _format_number_ranges(sorted(texts))
        text = f"task_index is {shown} in some rows, {listing} lists {listed}"
        findings.append(Finding("warning", text))
    yield Texts(
        "/task", tuple(texts[int(index[row, 0])] for row in rows), ns[rows], {FEATURE: "task"}
    )


def _read_lerobot_camera(
    name: str,
    known: DatasetLayout,
    number: int,
    ns: Array,
    shown: Array,
    begin_s: float,
    where: Sequence[tuple[int, int]],
    findings: list[Finding],
    limits: Input,
) -> Iterator[EpisodeCamera]:
    about = known.features[name]
    topic = f"/{escape_topic_name(name.removeprefix('observation.images.').replace('.', '/'))}"
    metadata = {FEATURE: name}
    if of_depth := _is_depth(name, about):
        findings.append(Finding("info", f"{name}: depth, which is not read"))
    if about["dtype"] == "image" and of_depth:
        return
    if about["dtype"] == "image":
        table = known.table(number)
        read = partial(_of_table, table, name, where, limits)
        yield EpisodeCamera(f"{topic}/image/compressed", ns, read, None, "png", metadata)
        return
    try:
        part = known.video(number, name)
        if not part.path.is_file():
            raise LogError(
                f"{part.path}: there is no such file; is the dataset downloaded completely?"
            )
        if of_depth:
            return
        film = video.survey_video(part.path, limits)
    except InputError as problem:
        findings.append(Finding("lost", f"{name}: {problem}"))
        return
    findings += compare_video(name, about, film, known.fps)
    frames = _frames_of_rows(film, part, begin_s, shown, known.fps)
    t = film.t[frames] - (film.t[frames[0]] if len(frames) else 0.0)
    times, more = _match_frame_times(name, t, ns, shown, known.fps)
    findings += more
    reader: Callable[[], Iterator[Item]] = partial(_of_video, film, frames)
    grey: Callable[[], Iterator[Item]] = partial(_of_video, film, frames, grey=True)
    yield EpisodeCamera(
        f"{topic}/image", times, reader, (film.width, film.height), "", metadata, grey
    )


def _lacks_image_column(name: str, about: Mapping[str, Any], columns: Mapping[str, str]) -> bool:
    """Whether a table lacks the images that info.json declares in it; depth is not read anyway."""
    return about.get("dtype") == "image" and name not in columns and not _is_depth(name, about)


def _is_depth(name: str, about: Mapping[str, Any]) -> bool:
    """Whether a camera's images are of depth: info.json says so, or its name and one channel do."""
    shape = about.get("shape")
    if is_named_depth(name) and isinstance(shape, list) and 1 in shape:
        return True
    found = {**_mapping_or_empty(about.get("info")), **_mapping_or_empty(about.get("video_info"))}
    return bool(found.get("is_depth_map") or found.get("video.is_depth_map"))


def _mapping_or_empty(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _frames_of_rows(
    film: video.Video, part: EpisodePart, begin_s: float, shown: Array, fps: float
) -> Array:
    """The numbers (K,) of an episode's frames in a video
    that may be shared, from its start to before its end.

    A table whose `timestamp` begins at `begin_s`, a frame and more after 0 s, has the frames from
    there to its last row; one with rows at a lower rate than the video's has those frames at the
    rows' times `shown` (N,) s.
    """
    steps = np.diff(film.t)
    # rows may be fewer than the video's frames: half a frame is less than half a row then
    margin = 0.5 * min(1.0 / fps, float(np.median(steps)) if len(steps) else np.inf)
    later = begin_s if begin_s > margin and part.start + begin_s < film.t[-1:].sum() else 0.0
    start = part.start + later
    end = part.end
    if later and len(shown):
        end = start + float(shown[-1]) + margin
        end = end if part.end is None else min(end, part.end)
    first = int(np.searchsorted(film.t, start - margin)) if start else 0
    last = (
        len(film.t)
        if end is None
        else int(np.searchsorted(film.t, end - (0.0 if later else margin)))
    )
    frames = np.arange(first, last)
    if len(frames) < 2 or len(shown) < 2:
        return frames
    interval_s = float(np.median(np.diff(film.t[first:last])))
    if np.median(np.diff(shown)) < _SPARSE * interval_s:
        return frames
    wanted = film.t[first] + shown
    nearest = first + np.searchsorted(film.t[first:last], wanted - 0.5 * interval_s)
    nearest = np.minimum(nearest, last - 1)
    exact = np.abs(film.t[nearest] - wanted).max() < _EXACT_S
    return nearest if exact and (np.diff(nearest) > 0).all() else frames


def _match_frame_times(
    name: str, t: Array, ns: Array, shown: Array, fps: float
) -> tuple[Array, list[Finding]]:
    """Times (ns) of frames at t (K,) s in a video: frame k
    has the time of row k, `shown` then, if the counts agree.
    """
    if len(t) != len(ns):
        less = "lost" if len(t) < len(ns) else "warning"
        text = (
            f"{name}: the video has {len(t)} frames, the table {len(ns)} rows; frames are dated "
            "by the video"
        )
        return (ns[0] if len(ns) else EPOCH_NS) + np.rint(t * 1e9).astype(np.int64), [
            Finding(less, text)
        ]
    worst = float(np.abs(t - shown).max(initial=0.0))
    if worst <= 0.5 / fps:
        return ns, []
    text = (
        f"{name}: the video's times and the table's drift apart, by up to {worst:.3g} s; frame k "
        "is dated by row k"
    )
    return ns, [Finding("warning", text)]


def _of_table(
    table: Path, name: str, where: Sequence[tuple[int, int]], limits: Input
) -> Iterator[Item]:
    yield from enumerate(parquet.read_encoded_images(table, name, where, limits))


def _of_video(film: video.Video, frames: Array, grey: bool = False) -> Iterator[Item]:
    if not len(frames):
        return
    places = {number: place for place, number in enumerate(frames.tolist())}
    for number, image in video.iterate_video_images(
        film, int(frames[0]), int(frames[-1]) + 1, grey
    ):
        if number in places:
            yield places[number], image

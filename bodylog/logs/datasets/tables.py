"""A folder of tables, images and videos as a log, or a
lone video: tables give images and frames their times.

A table with a column of image files is a camera; one named
like a video gives its frames' times; numbers are joints.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ...errors import BodylogError, LogError
from ...io import episodes
from ...io.contained import file_inside, is_inside
from ...io.values import log_times_ns
from ..limits import LIMITS, Input
from ..records import Array, Finding
from ..tables.pose_columns import are_image_files, is_label_column, time_column
from ..tables.table_file import SUFFIXES, read_table_file
from ..topics import escape_topic_name
from . import video
from .episode_log import (
    EPOCH_NS,
    JOINT_STATE,
    JOINTS,
    Episode,
    EpisodeCamera,
    EpisodeLog,
    EpisodeSignal,
    Item,
    Texts,
)
from .units import guess_joint_unit

_LARGEST = 64 << 20
_MOST_FILES = 10_000
_ENDINGS = ("", "_timestamps", "_times", ".timestamps", ".times", "_stamps")
_PLACES = ("", "data", "images")
"""Folders beside a table that may hold the images it names."""


@dataclass(frozen=True, eq=False)
class _Dated:
    """A table: its file, its name, times t (N,) s, numbers and image files by column."""

    path: Path
    name: str
    t: Array
    numbers: Mapping[str, Array]
    images: Mapping[str, Array]


def is_tables(folder: Path) -> bool:
    """Whether a folder holds tables or videos, and is not a recording."""
    return any(True for _ in _files_with_suffixes(folder, (*SUFFIXES, *video.SUFFIXES)))


def open_folder(path: Path, strict: bool = False, limits: Input = LIMITS) -> EpisodeLog:
    """Open the folder as a log; LogError when no table gives times."""
    if episodes.split_episode_name(path)[1] is not None:
        raise LogError(f"{path}: the folder holds no episodes; leave out the #")
    findings: list[Finding] = []
    files = _files_in_folder(_files_with_suffixes(path, tuple(SUFFIXES)), path, findings)
    tables = [one for file in files for one in _read_timed_table(file, path, findings, limits)]
    films = _survey_videos(
        list(_files_in_folder(_files_with_suffixes(path, video.SUFFIXES), path, findings)),
        limits,
        findings,
    )
    return EpisodeLog(path, _build_table_episode(path, tables, films, findings), strict)


def open_video(path: Path, strict: bool = False, limits: Input = LIMITS) -> EpisodeLog:
    """Open a video as a log, with times from a table beside it, else its own."""
    if episodes.split_episode_name(path)[1] is not None:
        raise LogError(f"{path}: a video holds no episodes; leave out the #")
    film = video.survey_video(path, limits)
    findings = list[Finding]()
    table = table_beside(path)
    tables = [] if table is None else list(_read_timed_table(table, path.parent, findings, limits))
    return EpisodeLog(path, _build_table_episode(path, tables, [film], findings, "video"), strict)


def table_beside(film: Path) -> Path | None:
    """The table with a video's frame times, by its
    name: side.csv, side_timestamps.csv for side.mp4.
    """
    names = (
        film.with_name(f"{film.stem}{ending}{suffix}") for ending in _ENDINGS for suffix in SUFFIXES
    )
    return next((path for path in names if path.is_file()), None)


def times_beside(film: Path) -> Array | None:
    """The times (N,) s of the table beside a video; None without one, LogError without times."""
    table = table_beside(film)
    findings = list[Finding]()
    if table is None:
        return None
    found = next(iter(_read_timed_table(table, film.parent, findings)), None)
    if found is None:
        raise LogError(f"{film.parent / findings[-1].text}; rename it, or type: [topics] rate")
    return found.t


def _files_in_folder(
    files: Iterator[Path], folder: Path, findings: list[Finding]
) -> Iterator[Path]:
    """The files that stand in the folder; one behind a link out of it gives a finding."""
    for file in files:
        if is_inside(file, folder):
            yield file
        else:
            text = "is a link out of the folder; copy the file in its place"
            findings.append(Finding("lost", f"{file.relative_to(folder)}: {text}"))


def _survey_videos(
    files: Sequence[Path], limits: Input, findings: list[Finding]
) -> list[video.Video]:
    found = []
    for file in files:
        try:
            found.append(video.survey_video(file, limits))
        except LogError as problem:
            findings.append(Finding("lost", str(problem)))
    return found


def _files_with_suffixes(folder: Path, suffixes: tuple[str, ...]) -> Iterator[Path]:
    """The folder's files with these suffixes, and tables in its subfolders, in name order."""
    names = sorted(path for path in folder.iterdir() if path.name[0] != ".")[:_MOST_FILES]
    yield from (path for path in names if path.suffix.lower() in suffixes and path.is_file())
    for inner in (path for path in names if path.is_dir() and not path.is_symlink()):
        more = sorted(path for path in inner.iterdir() if path.suffix.lower() in suffixes)[
            :_MOST_FILES
        ]
        yield from (path for path in more if path.suffix.lower() in SUFFIXES and path.is_file())


def _read_timed_table(
    file: Path, folder: Path, findings: list[Finding], limits: Input = LIMITS
) -> Iterator[_Dated]:
    """A table whose rows have times; any other table gives a finding."""
    where = file.relative_to(folder)
    try:
        table = read_table_file(file, SUFFIXES[file.suffix.lower()], limits)
    except BodylogError as problem:
        findings.append(Finding("lost", str(problem)))
        return
    findings += [Finding("lost", f"{where}: {text}") for text in table.lost]
    numbers = {_undecorated_column(name): values for name, values in table.numbers.items()}
    column, t = time_column(numbers)
    if column is None or not np.isfinite(t).all() or np.abs(t).max(initial=0) > 4e9:
        reason = (
            "no column of times dates every row"
            if column is None
            else f"column {column} does not date every row"
        )
        text = (
            f"{where}: {reason}, so the table is not used; its columns are "
            f"{', '.join(table.names[:12])}"
        )
        findings.append(Finding("warning", text))
        return
    images = {
        _undecorated_column(name): files
        for name, files in table.texts.items()
        if are_image_files(files)
    }
    joints = {name: values for name, values in numbers.items() if _is_joint(name, values)}
    name = file.parent.name if file.stem.lower() == "data" and file.parent != folder else file.stem
    yield _Dated(file, name, t, joints, images)


def _is_joint(name: str, values: Array) -> bool:
    return (
        time_column({name: values})[0] is None
        and not is_label_column(name)
        and bool(np.isfinite(values).any())
    )


def _undecorated_column(name: str) -> str:
    """A column's name without EuRoC's decoration: `#timestamp [ns]` is timestamp_ns."""
    return re.sub(r"\s*[\[(](\w+)[\])]$", r"_\1", name.lstrip("# "))


def _build_table_episode(
    path: Path,
    tables: Sequence[_Dated],
    films: Sequence[video.Video],
    findings: list[Finding],
    form: str = "tables",
) -> Episode:
    first = min((float(one.t.min()) for one in tables), default=0.0)
    shift = 0.0 if first >= 1.0 else EPOCH_NS / 1e9 - first
    streams: list[EpisodeSignal | Texts | EpisodeCamera] = []
    beside: dict[Path, _Dated] = {}
    for film in films:
        own = next((one for one in tables if _matches_video_frames(one, film)), None)
        beside |= {} if own is None else {own.path: own}
        streams += _build_video_camera(film, own, shift, findings)
    free = JOINTS
    for one in tables:
        for column, files in one.images.items():
            streams.append(_build_image_camera(one, column, files, shift))
        if one.numbers and one.path not in beside:
            streams.append(
                _build_joint_signal(one, free or f"/{escape_topic_name(one.name)}", shift, findings)
            )
            free = ""
    if not streams:
        raise LogError(
            f"{path}: no table with a column of times has images or joints, e.g. t,file or t,elbow"
        )
    return Episode(form, streams, findings)


def _matches_video_frames(table: _Dated, film: video.Video) -> bool:
    return not table.images and table.path.stem in {
        f"{film.path.stem}{ending}" for ending in _ENDINGS
    }


def _build_video_camera(
    film: video.Video, table: _Dated | None, shift: float, findings: list[Finding]
) -> Iterator[EpisodeCamera]:
    """A video as a camera: frame k has the time of row k of its table, or its presentation time."""
    t = film.t - film.t[0] + EPOCH_NS / 1e9 if table is None and len(film.t) else film.t
    if table is not None:
        t = table.t + shift
    count = min(len(t), len(film.t))
    if len(t) != len(film.t):
        text = f"{film.path.name}: the video has {len(film.t)} frames, its table {len(t)} rows"
        findings.append(Finding("lost", f"{text}; frame k is dated by row k"))
    reader = partial(_video_frame_images, film, count)
    yield EpisodeCamera(
        f"/{escape_topic_name(film.path.stem)}/image",
        _seconds_to_ns(t[:count]),
        reader,
        (film.width, film.height),
    )


def _build_image_camera(table: _Dated, column: str, files: Array, shift: float) -> EpisodeCamera:
    several = len(table.images) > 1
    topic = f"/{escape_topic_name(f'{table.name}/{column}' if several else table.name)}/image/compressed"
    rows = np.array([k for k, name in enumerate(files.tolist()) if name], np.int64)
    names = tuple(str(files[row]) for row in rows.tolist())
    return EpisodeCamera(
        topic,
        _seconds_to_ns(table.t[rows] + shift),
        partial(_files_of, table.path.parent, names),
        None,
        "jpeg",
    )


def _build_joint_signal(
    table: _Dated, topic: str, shift: float, findings: list[Finding]
) -> EpisodeSignal:
    names = tuple(table.numbers)
    values = np.column_stack(list(table.numbers.values()))
    of = guess_joint_unit({}, names, values)
    findings.append(Finding(of.remark[0], f"{table.path.name}: {of.remark[1]}"))
    return EpisodeSignal(
        topic, JOINT_STATE, names, values, _seconds_to_ns(table.t + shift), of.metadata
    )


def _seconds_to_ns(t: Array) -> Array:
    return log_times_ns(np.rint(t * 1e9).astype(np.int64))


def _video_frame_images(film: video.Video, count: int) -> Iterator[Item]:
    yield from video.iterate_video_images(film, 0, count)


def _files_of(folder: Path, names: Sequence[str]) -> Iterator[Item]:
    """The bytes of image files; None for those missing, too large, or outside the folder."""
    for number, name in enumerate(names):
        yield (
            number,
            next(
                (data for place in _PLACES if (data := _read_image_file(folder, place, name))), None
            ),
        )


def _read_image_file(folder: Path, place: str, name: str) -> bytes | None:
    file = file_inside(folder, str(Path(place) / name))
    try:
        return file.read_bytes() if file is not None and file.stat().st_size <= _LARGEST else None
    except OSError:
        return None

"""HDF5 episodes as logs: ALOHA (/observations/qpos, /action), robomimic (/data/demo_N/obs/…) and
DROID (/observation/robot_state/joint_positions, with videos beside)."""

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError, InputError, LogError
from ...io import episodes
from ...io.contained import is_inside
from ...io.values import log_times_ns
from ..limits import LIMITS, Input, TableSize
from ..records import Array, Finding
from ..storage.compression import Allowance
from ..topics import escape_topic_name
from . import video
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
from .hdf5_file import (
    Sets,
    explain_refused_dataset,
    is_bytes_list,
    open_hdf5_file,
    read_attribute,
    read_float_rows,
    row_blocks,
    rows_at_once,
    sets_of,
)
from .units import guess_joint_unit

_ROW_BYTES = 32
"""Bytes that the times of a row take while they are made."""
_ALOHA_HZ = 50.0
"""Rate of ALOHA's recordings (DT = 0.02 s in its constants); its files hold no times."""
_ALOHA_ARM = (
    "waist",
    "shoulder",
    "elbow",
    "forearm_roll",
    "wrist_angle",
    "wrist_rotate",
    "gripper",
)
_TIMES = re.compile(
    r"(^|/)(timestamps?|times?|stamps?|t|step_start)(_(ns|us|ms|s))?$", re.IGNORECASE
)
_SCALE = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}
_JOINTS = re.compile(
    r"(?!(actions?|next_obs)/)(.*/)?(qpos|joint_pos(itions?)?|robot\d*_joint_pos)$"
)
_ACTION = re.compile(r"actions?(/joint_position)?")
_VIDEOS = "recordings/MP4"
_STEREO = "-stereo"
_CAPTURED = "observation/timestamp/cameras/{}_estimated_capture"
_NEXT = "next_obs/"
"""Prefix of what robomimic stores a second time, a step later."""


def open_hdf5(path: Path, strict: bool = False, limits: Input = LIMITS) -> EpisodeLog:
    """Open an episode of an HDF5 file: FILE#N is number N, FILE the first."""
    file, number = episodes.split_episode_name(path)
    findings: list[Finding] = []
    with open_hdf5_file(file) as one:
        found = sets_of(one, file, number, findings, limits)
        episode = _read_hdf5_episode(file, found, findings, limits)
    return EpisodeLog(path, episode, strict)


def _read_hdf5_episode(path: Path, found: Sets, findings: list[Finding], limits: Input) -> Episode:
    rows = _count_steps(found.sets)
    if not rows:
        some = ", ".join(list(found.sets)[:8]) or "none"
        text = "no qpos, joint_pos, action or images as ALOHA and robomimic keep them"
        raise LogError(f"{path}: {text}; its datasets are {some}")
    size = TableSize(limits)
    size.take(_ROW_BYTES * rows, f"{path}: the times of {rows} rows")
    ns = _find_step_times(found, rows, findings, limits)
    streams: list[EpisodeSignal | Texts | EpisodeCamera] = []
    joints = next(
        (
            name
            for name in found.sets
            if _JOINTS.match(name) and _is_numeric_dataset(found.sets[name])
        ),
        None,
    )
    lengths = {
        name: one.shape[0]
        for name, one in found.sets.items()
        if _is_row(one) and not name.startswith(_NEXT)
    }
    for name in lengths:
        own = ns[: lengths[name]] if lengths[name] <= rows else None
        if lengths[name] != rows:
            findings.append(
                Finding("warning", f"{name}: {lengths[name]} rows, {joints or 'the others'} {rows}")
            )
        if own is None or not len(own) or (_TIMES.search(name) and found.sets[name].ndim == 1):
            continue
        streams += _read_stream(path, found, name, own, joints, findings, limits, size)
    streams += _read_videos_beside(path, found, ns, findings, limits)
    return Episode(found.format, streams, findings)


def _is_row(one: Any) -> bool:
    """Whether a dataset has a row for each step."""
    return one.ndim >= 1 and one.dtype.kind in "fiubO" and one.shape[0] > 0


def _is_numeric_dataset(one: Any) -> bool:
    return _is_row(one) and one.dtype.kind in "fiub" and one.ndim == 2


def _count_steps(sets: Mapping[str, Any]) -> int:
    """Steps of the episode: rows of the joints, else of the action, else of most datasets."""
    known = {name: int(one.shape[0]) for name, one in sets.items() if _is_row(one)}
    wanted = [
        rows
        for name, rows in known.items()
        if _JOINTS.match(name) or re.search(r"(^|/)actions?$", name)
    ]
    images = [rows for name, rows in known.items() if _is_image_dataset(name, sets[name])]
    every = wanted or images
    return every[0] if every else 0


def _is_image_dataset(name: str, one: Any) -> bool:
    """(T,H,W,3) or (T,H,W,1) bytes, or JPEG and PNG in
    (T,L) bytes or variable-length rows, named like images.
    """
    if one.dtype == np.uint8 and one.ndim == 4:
        return one.shape[3] in (1, 3)
    return bool(re.search(r"image|rgb|cam", name)) and (
        (one.dtype == np.uint8 and one.ndim == 2 and one.shape[1] > 64)
        or (is_bytes_list(one) and one.ndim == 1)
    )


def _find_step_times(found: Sets, rows: int, findings: list[Finding], limits: Input) -> Array:
    """Times of the steps (N,) int64 ns: a dataset of times, else step numbers at the known rate."""
    for name, one in found.sets.items():
        if (match := _TIMES.search(name)) and one.shape == (rows,) and one.dtype.kind in "fiu":
            try:
                ns = _time_column_ns(_read_time_column(name, one, limits), match[4])
            except FormatError as problem:
                findings.append(Finding("lost", str(problem)))
                continue
            if ns is not None and (np.diff(ns) > 0).all():
                return ns
            findings.append(Finding("warning", f"{name} does not rise in every row; not used"))
    if found.rate is not None:
        findings.append(
            Finding(
                "info", f"no times; rows are dated at the {found.rate:g} Hz that the file states"
            )
        )
    else:
        text = f"no times and no rate in the file; rows are dated at ALOHA's {_ALOHA_HZ:g} Hz"
        findings.append(Finding("warning", text))
    return EPOCH_NS + np.rint(np.arange(rows) / (found.rate or _ALOHA_HZ) * 1e9).astype(np.int64)


def _read_time_column(name: str, one: Any, limits: Input) -> Array:
    """All values of a dataset of one column, in its
    own type; FormatError where they may not be read.
    """
    if reason := explain_refused_dataset(one, limits):
        raise FormatError(f"{name}: {reason}")
    blocks = [rows for _, rows in row_blocks(one, one.shape[0], limits)]
    return np.concatenate(blocks) if blocks else np.empty(0, one.dtype)


def _time_column_ns(values: Array, ending: str | None) -> Array | None:
    """Times as int64 ns: by the suffix of their name,
    else by their size; None if they are not times.
    """
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        return None
    largest = float(np.abs(values).max(initial=0))
    scale = _SCALE.get((ending or "").lower(), _scale_by_size(largest))
    if not largest * scale <= 4e9:
        return None
    ns = (
        values.astype(np.int64) * round(scale * 1e9)
        if values.dtype.kind in "iu"
        else np.rint(values.astype(float) * scale * 1e9).astype(np.int64)
    )
    return log_times_ns(
        ns if len(ns) and ns.min() >= EPOCH_NS else ns - ns.min(initial=0) + EPOCH_NS
    )


def _scale_by_size(largest: float) -> float:
    """Seconds that one unit of times since 1970 has, whose largest is given; 1 of other times."""
    return 1e-9 if largest > 1e17 else 1e-3 if 1e12 < largest < 4e12 else 1.0


def _read_stream(
    path: Path,
    found: Sets,
    name: str,
    ns: Array,
    joints: str | None,
    findings: list[Finding],
    limits: Input,
    size: TableSize,
) -> Iterator[EpisodeSignal | EpisodeCamera]:
    one = found.sets[name]
    if _is_image_dataset(name, one):
        yield from _read_hdf5_camera(path, found, name, ns, findings, limits)
        return
    of_depth = one.ndim >= 3 and is_named_depth(name)
    if of_depth or one.dtype.kind not in "fiub" or one.ndim > 3:
        kind = "depth" if of_depth else str(one.dtype)
        findings.append(Finding("info", f"{name}: {kind} of shape {one.shape}, which is not read"))
        return
    try:
        size.take(8 * one.size, name)
        if reason := explain_refused_dataset(one, limits):
            raise FormatError(f"{name}: {reason}")
        values = read_float_rows(one, limits)
    except InputError as problem:
        findings.append(Finding("lost", str(problem)))
        return
    short = re.sub(r"^(obs|observations)/", "", name)
    topic = f"/{escape_topic_name(short)}"
    kind = VECTOR
    metadata = {FEATURE: _lerobot_feature_name(name), DTYPE: str(one.dtype)}
    of_joints = name == joints or bool(_ACTION.fullmatch(name))
    of_aloha = of_joints and joints is not None and joints.endswith("qpos")
    names = _joint_or_index_names(values.shape[1], found.format, of_aloha)
    if name == joints or _ACTION.fullmatch(name):
        topic = JOINTS if name == joints else ACTION
        kind = JOINT_STATE
        of = guess_joint_unit(
            {key: _decode_hdf5_text(read_attribute(one, key)) for key in ("unit", "units")},
            names,
            values,
        )
        metadata |= of.metadata
        findings += [Finding(*of.remark)] if name == joints else []
    yield EpisodeSignal(topic, kind, names, values, ns, metadata)


def _lerobot_feature_name(name: str) -> str:
    """LeRobot's name for a dataset."""
    if _JOINTS.match(name):
        return "observation.state"
    if _ACTION.fullmatch(name):
        return "action"
    short = re.sub(r"^(obs|observations)/", "observation.", name)
    return short.replace("/", ".")


def _decode_hdf5_text(value: Any) -> Any:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _read_videos_beside(
    path: Path, found: Sets, ns: Array, findings: list[Finding], limits: Input
) -> Iterator[EpisodeCamera]:
    """DROID's videos beside the file: frame k has the time at which row k says that it was taken,
    else the row's. Of a stereo camera the left one is read where it has a file of its own."""
    folder = path.parent / _VIDEOS
    for file in sorted(folder.glob("*.mp4")) if folder.is_dir() else ():
        serial = file.stem.removesuffix(_STEREO)
        where = f"{_VIDEOS}/{file.name}"
        if file.stem != serial and (folder / f"{serial}.mp4").is_file():
            continue
        if not is_inside(file, path.parent):
            findings.append(Finding("lost", f"{where}: is a link out of the folder"))
            continue
        try:
            film = video.survey_video(file, limits)
        except LogError as problem:
            findings.append(Finding("lost", str(problem)))
            continue
        t = ns
        captured = found.sets.get(_CAPTURED.format(serial))
        if captured is not None and captured.shape == ns.shape:
            taken = _time_column_ns(_read_time_column(serial, captured, limits), None)
            t = ns if taken is None or not (np.diff(taken) > 0).all() else taken
        count = min(len(film.t), len(ns))
        if len(film.t) != len(ns):
            text = f"{where}: {len(film.t)} frames, {len(ns)} rows; frame k is dated by row k"
            findings.append(Finding("warning", text))
        topic = f"/{escape_topic_name(f'cam_{serial}')}/image"
        read = partial(video.iterate_video_images, film, 0, count)
        metadata = {FEATURE: f"observation.images.{serial}"}
        size = (film.width, film.height)
        grey = partial(video.iterate_video_images, film, 0, count, True)
        yield EpisodeCamera(topic, t[:count], read, size, "", metadata, grey)


def _joint_or_index_names(count: int, form: str, of_joints: bool) -> tuple[str, ...]:
    """ALOHA's names of its arms' joints; else their indices."""
    if of_joints and form == "hdf5" and count in (7, 14):
        sides = ("left_", "right_") if count == 14 else ("",)
        return tuple(f"{side}{name}" for side in sides for name in _ALOHA_ARM)
    return tuple(map(str, range(count)))


def _read_hdf5_camera(
    path: Path, found: Sets, name: str, ns: Array, findings: list[Finding], limits: Input
) -> Iterator[EpisodeCamera]:
    one = found.sets[name]
    short = re.sub(r"^.*?(images?)/", "", name)
    topic = (
        f"/{escape_topic_name(re.sub(r'^(obs|observations)/', '', short).removesuffix('_image'))}"
    )
    metadata = {FEATURE: f"observation.images.{topic[1:].replace('/', '.')}"}
    place = f"{found.group}/{name}"
    if len(ns) > limits.max_frames:
        asked = f"to read them, type in robot.toml: [input] max_frames = {len(ns)}"
        findings.append(Finding("lost", f"{name}: {len(ns)} images; {asked}"))
        return
    height, width = one.shape[1:3] if one.ndim == 4 else (0, 0)
    too_wide = one.ndim == 4 and not 0 < height * width <= limits.max_image_mpx * 1e6
    if too_wide or (one.ndim == 2 and one.shape[1] > limits.max_message_mb * 1e6):
        findings.append(
            Finding("lost", f"{name}: images of shape {one.shape[1:]}; too large to be read")
        )
    elif reason := explain_refused_dataset(one, limits):
        findings.append(Finding("lost", f"{name}: {reason}"))
    elif one.ndim == 4:
        read = partial(_read_raw_images, path, place, len(ns), limits)
        yield EpisodeCamera(f"{topic}/image", ns, read, (width, height), "", metadata)
    else:
        read = partial(_read_compressed_images, path, place, len(ns), limits)
        yield EpisodeCamera(f"{topic}/image/compressed", ns, read, None, "jpeg", metadata)


def _read_raw_images(path: Path, place: str, count: int, limits: Input) -> Iterator[Item]:
    """RGB images (T,H,W,3), or grey ones, row by row, as BGR."""
    for number, image in _limited_dataset_rows(path, place, count, limits):
        if image is not None:
            image = np.ascontiguousarray(np.broadcast_to(image, (*image.shape[:2], 3))[:, :, ::-1])
        yield number, image


def _read_compressed_images(path: Path, place: str, count: int, limits: Input) -> Iterator[Item]:
    """JPEG or PNG images row by row, without the zeros that pad a row."""
    for number, row in _limited_dataset_rows(path, place, count, limits):
        data = b"" if row is None else np.asarray(row, np.uint8).tobytes().rstrip(b"\0")
        yield number, data or None


def _limited_dataset_rows(
    path: Path, place: str, count: int, limits: Input
) -> Iterator[tuple[int, Array | None]]:
    """The rows of a dataset; None for unreadable ones;
    LogError where they are more than a file may unpack to.
    """
    allowance = Allowance(path, limits)
    packed = path.stat().st_size
    unpacked = 0
    with open_hdf5_file(path) as file:
        one = file[place]
        for first, rows in _read_row_blocks(one, count, limits):
            for number, row in enumerate(rows, first):
                unpacked += 0 if row is None else row.nbytes
                allowance.check(packed, unpacked)
                yield number, row


def _read_row_blocks(
    one: Any, count: int, limits: Input
) -> Iterator[tuple[int, Sequence[Array | None]]]:
    """Rows by blocks; of a block that cannot be read,
    row by row; one by one if their size is in each row.
    """
    if is_bytes_list(one):
        yield from ((number, [_read_dataset_row(one, number)]) for number in range(count))
        return
    blocks = row_blocks(one, count, limits)
    at = 0
    while at < count:
        try:
            first, rows = next(blocks)
        except FormatError:
            raise
        except (OSError, RuntimeError, ValueError):
            end = min(at + rows_at_once(one), count)
            yield from ((number, [_read_dataset_row(one, number)]) for number in range(at, end))
            at = end
            blocks = row_blocks(one, count, limits, end)
            continue
        yield first, list(rows)
        at = first + len(rows)


def _read_dataset_row(one: Any, number: int) -> Array | None:
    """A row, or None if it cannot be read."""
    try:
        return np.asarray(one[number])
    except (OSError, RuntimeError, ValueError):
        return None

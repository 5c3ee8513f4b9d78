"""Write logs as a LeRobot dataset, v3.0 or v2.1: one
episode each, with the times of every row and image.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError, UsageError
from ..io.atomic_files import require_writable, sync_to_disk
from ..io.extras import require_module
from ..io.temporary import create_scratch_folder
from ..logs.datasets.encode import Codec, encode_video, find_codec
from ..logs.datasets.statistics import Sampled, combine_statistics, of_numbers
from ..logs.protocol import Progress
from ..settings import Settings
from ..types import Array, Finding
from .dataset_rows import DatasetCamera, DatasetRows, Feature, read_dataset_rows

V3 = "lerobot"
V21 = "lerobot-2.1"
FORMS = (V3, V21)
STAMP = ".stamp_ns"
_TOLERANCE = 1e-4
"""s: LeRobot rejects images that are further from frame_index / fps."""
_CHUNK = 1000
_WHOLE = ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "bool")
_PATHS = {
    V3: (
        "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    ),
    V21: (
        "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
    ),
}


@dataclass
class _Written:
    """A dataset in progress: its folder, form, codec, and its episodes so far."""

    folder: Path
    form: str
    codec: Codec
    progress: Progress | None = None
    features: dict[str, dict[str, Any]] = field(default_factory=dict)
    fps: float = 0.0
    robot: str | None = None
    tasks: dict[str, int] = field(default_factory=dict)
    episodes: list[dict[str, Any]] = field(default_factory=list)
    stats: list[dict[str, dict[str, Any]]] = field(default_factory=list)
    frames: int = 0


def write_lerobot(
    logs: Sequence[Path],
    out: Path,
    settings: Settings,
    form: str = V3,
    how: str = "lossless",
    task: str | None = None,
    progress: Progress | None = None,
    start: float | None = None,
    end: float | None = None,
) -> tuple[Finding, ...]:
    """Write a LeRobot folder `out` with an episode per log; an exception leaves nothing.

    form: lerobot (v3.0) or lerobot-2.1 · how: lossless, h264 or av1 · start, end: s since the log's
    first joints · progress: called with the number of further images done.
    """
    for module in ("pyarrow", "av"):
        require_module(module, out)
    out = new_folder(out)
    with create_scratch_folder(out.parent) as folder:
        done = _Written(folder / out.name, form, find_codec(how), progress)
        done.folder.mkdir()
        findings = [
            one
            for log in logs
            for one in _write_episode(done, read_dataset_rows(log, settings, task, start, end), log)
        ]
        _write_metadata_files(done)
        for path in sorted(done.folder.rglob("*")):
            sync_to_disk(path)
        done.folder.rename(out)
        sync_to_disk(out.parent)
    return tuple(dict.fromkeys(findings))


def new_folder(out: Path) -> Path:
    """The folder to make; UsageError if it exists."""
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise UsageError(f"{out}: already exists; give the name of a new folder with -o")
    require_writable(out.absolute().parent, folder=True)
    if not out.absolute().parent.is_dir():
        raise UsageError(f"{out}: there is no folder {out.parent}; type: mkdir -p {out.parent}")
    return out


def _write_episode(done: _Written, found: DatasetRows, log: Path) -> Sequence[Finding]:
    """Write one episode's table and videos; returns findings."""
    number = len(done.episodes)
    count = len(found.ns)
    columns = _episode_columns(found)
    features = _declare_features(found, done.codec)
    if done.episodes and set(features) != set(done.features):
        odd = ", ".join(sorted(set(features) ^ set(done.features)))
        raise FormatError(
            f"{log}: its streams are not those of the first log: {odd}; convert it on its own"
        )
    done.features = features
    done.fps = found.fps
    done.robot = found.robot
    keys = _placeholder_values(done.form, number)
    task = done.tasks.setdefault(found.task, len(done.tasks))
    t = np.arange(count) / found.fps  # LeRobot finds image k of a video as frame round(t * fps)
    counted: dict[str, Array] = {
        "timestamp": t.astype(np.float32),
        "frame_index": np.arange(count),
        "episode_index": np.full(count, number),
        "index": done.frames + np.arange(count),
        "task_index": np.full(count, task),
    }
    _write_parquet_table(done.folder / _PATHS[done.form][0].format(**keys), columns | counted)
    row: dict[str, Any] = {"episode_index": number, "tasks": [found.task], "length": count}
    if done.form == V3:
        row |= {"dataset_from_index": done.frames, "dataset_to_index": done.frames + count}
        row |= {f"data/{name}": keys[name] for name in ("chunk_index", "file_index")}
    stats = {name: of_numbers(values) for name, values in (columns | counted).items()}
    findings = [*found.findings, *_findings_on_row_times(found, t, log)]
    for name, view in found.views.items():
        findings += _write_video(done, name, view, t, keys, row, stats, log)
    done.episodes.append(row)
    done.stats.append(stats)
    done.frames += count
    return findings


def _findings_on_row_times(found: DatasetRows, t: Array, log: Path) -> Iterator[Finding]:
    """A remark where the rows' times are not those (s) that LeRobot expects."""
    apart = float(np.abs((found.ns - found.ns[0]) / 1e9 - t).max(initial=0.0))
    if apart > _TOLERANCE:
        severity = "warning" if apart > 0.5 / found.fps else "info"
        text = (
            f"timestamp is frame_index / {found.fps:g}, as LeRobot needs it; the rows' times "
            "differ by up to"
        )
        yield Finding(severity, f"{log}: {text} {apart:.3g} s, and are kept in NAME{STAMP}")


def _placeholder_values(form: str, number: int) -> dict[str, Any]:
    """The values for a path's placeholders: one file per episode."""
    if form == V21:
        return {"episode_chunk": number // _CHUNK, "episode_index": number}
    return {"chunk_index": number // _CHUNK, "file_index": number % _CHUNK}


def _episode_columns(found: DatasetRows) -> dict[str, Array]:
    """Features by name, (N,K) or (N,), and the times of those that differ from the rows'."""
    columns: dict[str, Array] = {}
    for name, one in found.features.items():
        values = _cast_to_declared(one)
        columns[name] = values[:, 0] if values.shape[1] == 1 else values
    stamps = {name: one.ns for name, one in found.features.items()} | {
        n: one.ns for n, one in found.views.items()
    }
    first = next(iter(stamps))  # readers give it the times of the rows
    apart = {
        name: ns
        for name, ns in stamps.items()
        if name == first or not np.array_equal(ns, stamps[first])
    }
    return columns | {f"{name}{STAMP}": ns for name, ns in apart.items()}


def _cast_to_declared(one: Feature) -> Array:
    """Values in their declared dtype if it holds them, else float32 or float64 without loss."""
    wanted = one.dtype or "float32"
    if wanted not in _WHOLE or np.isfinite(one.values).all():
        with np.errstate(over="ignore"):
            cast = one.values.astype(
                wanted if wanted in (*_WHOLE, "float32", "float64") else "float32"
            )
        came_in_degrees = one.unit == "deg" and cast.dtype == np.float32
        if came_in_degrees or np.array_equal(cast.astype(float), one.values, equal_nan=True):
            return cast
    return one.values


def _declare_features(found: DatasetRows, how: Codec) -> dict[str, dict[str, Any]]:
    """The features of info.json."""
    declared: dict[str, dict[str, Any]] = {}
    for name, values in _episode_columns(found).items():
        one = found.features.get(name)
        names = None if one is None else list(one.names)
        shape = [1 if values.ndim == 1 else values.shape[1]]
        declared[name] = {"dtype": str(values.dtype), "shape": shape, "names": names}
        if one is not None and one.unit and one.unit != "unknown":
            declared[name]["unit"] = one.unit
    for name, view in found.views.items():
        width, height = view.size
        about = {
            "video.fps": found.fps,
            "video.height": height,
            "video.width": width,
            "video.channels": 3,
            "video.codec": how.name,
            "video.pix_fmt": "gbrp" if how.pixels == "bgr24" else how.pixels,
            "video.is_depth_map": False,
            "has_audio": False,
        }
        names = ["height", "width", "channels"]
        declared[name] = {
            "dtype": "video",
            "shape": [height, width, 3],
            "names": names,
            "info": about,
        }
    for name in ("timestamp", "frame_index", "episode_index", "index", "task_index"):
        kind = "float32" if name == "timestamp" else "int64"
        declared[name] = {"dtype": kind, "shape": [1], "names": None}
    return declared


def _write_video(
    done: _Written,
    name: str,
    view: DatasetCamera,
    t: Array,
    keys: Mapping[str, Any],
    row: dict[str, Any],
    stats: dict[str, dict[str, Any]],
    log: Path,
) -> list[Finding]:
    """Write a camera's video; reports its error and missing images."""
    path = done.folder / _PATHS[done.form][1].format(**keys, video_key=name)
    path.parent.mkdir(parents=True, exist_ok=True)
    sampled = Sampled()
    passes = count()
    error = encode_video(
        path,
        done.codec,
        lambda: map(sampled.seen, _count_every_second_image(view, next(passes), done.progress)),
        t,
        view.size,
    )
    stats[name] = sampled.stats(len(t))
    if done.form == V3:
        row |= {f"videos/{name}/{key}": keys[key] for key in ("chunk_index", "file_index")}
        row |= {
            f"videos/{name}/from_timestamp": 0.0,
            f"videos/{name}/to_timestamp": float(t[-1]) + 1.0 / done.fps,
        }
    exact = (
        "every image as in the log"
        if error == 0
        else f"images differ by {error:.3g} grey levels (RMS)"
    )
    findings = [Finding("info", f"{log}: {name}: {done.codec.encoder}, {exact}")]
    if view.unread:
        text = (
            f"{log}: {name}: {len(view.unread)} of {len(t)} images cannot be read and repeat the "
            "previous one"
        )
        findings.append(Finding("lost", text))
    return findings


def _count_every_second_image(
    view: DatasetCamera, number: int, progress: Progress | None
) -> Iterator[Array]:
    """The images of a pass; of the two, written and
    read back, each reports every second image as done.
    """
    for k, image in enumerate(view.images()):
        if progress is not None and k % 2 == number % 2:
            progress(1)
        yield image


def _write_parquet_table(path: Path, columns: Mapping[str, Array]) -> None:
    arrow = require_module("pyarrow", path)
    parquet = require_module("pyarrow.parquet", path)
    made = {}
    for name, values in columns.items():
        flat = arrow.array(values.reshape(-1))
        made[name] = (
            flat
            if values.ndim == 1
            else arrow.FixedSizeListArray.from_arrays(flat, values.shape[1])
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(arrow.table(made), path, compression="snappy")


def _write_metadata_files(done: _Written) -> None:
    """Write info.json, stats, and the lists of episodes and tasks."""
    meta = done.folder / "meta"
    meta.mkdir()
    total = len(done.episodes)
    videos = sum(one["dtype"] == "video" for one in done.features.values())
    data_path, video_path = _PATHS[done.form]
    info: dict[str, Any] = {
        "codebase_version": "v3.0" if done.form == V3 else "v2.1",
        "robot_type": done.robot,
        "total_episodes": total,
        "total_frames": done.frames,
        "total_tasks": len(done.tasks),
        "chunks_size": _CHUNK,
        "fps": int(done.fps) if done.fps == int(done.fps) else done.fps,
        "splits": {"train": f"0:{total}"},
        "data_path": data_path,
        "video_path": video_path if videos else None,
        "features": done.features,
    }
    if done.form == V3:
        info |= {"data_files_size_in_mb": 100, "video_files_size_in_mb": 200}
        _write_episode_lists_v3(done, meta)
    else:
        info |= {"total_videos": videos * total, "total_chunks": -(-total // _CHUNK)}
        _write_episode_lists_v21(done, meta)
    (meta / "info.json").write_text(json.dumps(info, indent=4), encoding="utf-8")


def _write_episode_lists_v3(done: _Written, meta: Path) -> None:
    arrow = require_module("pyarrow", meta)
    parquet = require_module("pyarrow.parquet", meta)
    place = {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
    flat = [
        {
            **row,
            **place,
            **{
                f"stats/{name}/{key}": value
                for name, one in stats.items()
                for key, value in one.items()
            },
        }
        for row, stats in zip(done.episodes, done.stats, strict=True)
    ]
    path = meta / "episodes" / "chunk-000" / "file-000.parquet"
    path.parent.mkdir(parents=True)
    parquet.write_table(arrow.Table.from_pylist(flat), path)
    tasks = arrow.table({"task_index": list(done.tasks.values()), "task": list(done.tasks)})
    parquet.write_table(
        tasks.replace_schema_metadata({b"pandas": _PANDAS.encode()}), meta / "tasks.parquet"
    )
    (meta / "stats.json").write_text(
        json.dumps(combine_statistics(done.stats), indent=4), encoding="utf-8"
    )


_PANDAS = json.dumps(
    {
        "index_columns": ["task"],
        "column_indexes": [],
        "pandas_version": "2.0.0",
        "creator": {"library": "pyarrow"},
        "columns": [
            {
                "name": "task_index",
                "field_name": "task_index",
                "pandas_type": "int64",
                "numpy_type": "int64",
                "metadata": None,
            },
            {
                "name": "task",
                "field_name": "task",
                "pandas_type": "unicode",
                "numpy_type": "object",
                "metadata": None,
            },
        ],
    }
)
"""Declares the column `task` as the table's index, as LeRobot's loader needs it."""


def _write_episode_lists_v21(done: _Written, meta: Path) -> None:
    tasks = [{"task_index": index, "task": task} for task, index in done.tasks.items()]
    stats = [{"episode_index": number, "stats": one} for number, one in enumerate(done.stats)]
    for name, lines in (("episodes", done.episodes), ("tasks", tasks), ("episodes_stats", stats)):
        text = "".join(f"{json.dumps(line)}\n" for line in lines)
        (meta / f"{name}.jsonl").write_text(text, encoding="utf-8")

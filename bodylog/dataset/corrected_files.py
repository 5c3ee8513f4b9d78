"""Write a corrected LeRobot folder: images paired with the rows that they show, repeated frames
marked or left out, episodes left out; what does not change is copied byte for byte."""

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..choices import REPEATS
from ..errors import FormatError, InputError, LogError
from ..io import episodes
from ..io.atomic_files import sync_to_disk
from ..io.contained import is_inside
from ..io.extras import require_module
from ..io.temporary import create_scratch_folder
from ..logs.datasets import parquet, video
from ..logs.datasets.lerobot_layout import (
    EPISODE_STATISTICS,
    EPISODE_TABLES,
    EPISODES,
    INFO,
    STATISTICS,
    DatasetLayout,
    read_dataset_layout,
)
from ..logs.datasets.statistics import measure_like
from ..recording.lerobot_writer import STAMP, new_folder
from ..settings import Settings
from ..types import Array
from ..wording import list_in_words
from .remedies import CameraDelay, Remedy

MARK, DROP, KEEP = REPEATS
EXCLUDED = "meta/excluded.jsonl"
FIXED = "meta/fixed.json"
Films = Mapping[tuple[int, str], "RepeatedFrames"]
"""Repeated frames of cameras by episode and feature."""
REPEATED = "repeated."
"""Prefix of the features that mark repeated frames: none that a policy takes for an observation."""


@dataclass(frozen=True, eq=False)
class RepeatedFrames:
    """Whether each frame (N,) of a camera repeats the one before, and their share of those of which
    it is known."""

    flags: Array
    share: float


@dataclass(frozen=True, eq=False)
class Edit:
    """How the rows of an episode are taken.

    number: of the source · new: number in the output · offset, source_offset: its first row in the
    output, and in the source with the episodes that are kept · taken (n,): rows of the source ·
    frames {feature: frames by which images are late} · repeated {feature: (n,) whether the row's
    image repeats} · rows: of the source.
    """

    number: int
    new: int
    offset: int
    source_offset: int
    taken: Array
    rows: int
    frames: Mapping[str, int]
    delays: Mapping[str, CameraDelay]
    repeated: Mapping[str, Array] = field(default_factory=dict)

    @property
    def latest(self) -> int:
        """Frames by which the images of the latest camera are late."""
        return max(self.frames.values(), default=0)

    @property
    def is_unchanged(self) -> bool:
        """Whether the table's rows stay as they are."""
        stays = self.new == self.number and self.offset == self.source_offset
        return stays and self.takes_all and not self.repeated

    @property
    def takes_all(self) -> bool:
        """Whether every row of the source is taken with its own images."""
        return len(self.taken) == self.rows and not any(self.frames.values())


def write_corrected(
    folder: Path, remedies: Sequence[Remedy], out: Path, repeats: str, settings: Settings
) -> tuple[str, ...]:
    """Write the corrected dataset as the new folder `out`, whole or not at all, and return what was
    done in sentences."""
    out = new_folder(out)
    known = read_dataset_layout(folder)
    kept = [one for one in remedies if not one.excluded]
    if not kept:
        raise LogError(f"{folder}: all of its {len(remedies)} episodes are left out; none to write")
    films = {} if repeats == KEEP else _find_repeated(known, kept, settings)
    every = _repeat_factor(films) if repeats == DROP else 1
    edits = list(_edits(known, kept, films, every, repeats == MARK))
    with create_scratch_folder(out.parent) as place:
        target = place / out.name
        target.mkdir()
        work = _Work(known, replace(known, folder=target), edits, every)
        work.write_tables()
        work.write_videos()
        work.write_meta(remedies)
        work.copy_rest()
        _require_complete(target, edits)
        for path in sorted(target.rglob("*")):
            sync_to_disk(path)
        target.rename(out)
        sync_to_disk(out.parent)
    return tuple(_sentences(known, remedies, edits, every, work))


def _find_repeated(known: DatasetLayout, kept: Sequence[Remedy], settings: Settings) -> Films:
    """Whether each frame repeats the one before, of the cameras whose frames do."""
    return {
        (one.number, feature): _repeated_frames(known, one.number, feature, settings)
        for one in kept
        for feature in one.repeating
    }


def _repeat_factor(films: Films) -> int:
    """As how many frames a distinct one is stored; 1 without repeats."""
    shares = [film.share for film in films.values()]
    return max(1, round(1.0 / (1.0 - float(np.median(shares))))) if shares else 1


def _repeated_frames(
    known: DatasetLayout, number: int, feature: str, settings: Settings
) -> RepeatedFrames:
    """The repeated frames of a camera; one that cannot be decoded is not among them."""
    from ..delays.flow import alternating_repeats
    from ..logs.datasets.episode_log import FEATURE, EpisodeLog
    from ..logs.formats import open_log
    from ..perception.surface.repeats import RepeatSearch, shrink_grey
    from .reading import grey_frames

    log = episodes.name_episode(known.folder, number)
    search = RepeatSearch()
    with open_log(log, False, settings.input) as opened:
        assert isinstance(opened, EpisodeLog)
        camera = next(one for one in opened.cameras.values() if one.metadata[FEATURE] == feature)
        t = (camera.ns - camera.ns[0]) / 1e9
        for frame in grey_frames(camera, t, -np.inf, np.inf):
            with suppress(InputError):
                search.add(frame.t, shrink_grey(frame.decode(1)))
    found = search.repeats()
    flags = np.zeros(len(t), bool)
    flags[np.searchsorted(t, found.t)] = alternating_repeats(found)
    return RepeatedFrames(flags, found.share or 0.0)


def _edits(
    known: DatasetLayout, kept: Sequence[Remedy], films: Films, every: int, marks: bool
) -> Iterator[Edit]:
    offset = 0
    source_offset = 0
    cameras = [name for name, one in known.features.items() if one.get("dtype") in _IMAGES]
    for new, one in enumerate(kept):
        rows = sum(end - first for first, end in _where(known, one.number))
        frames = {name: 0 for name in cameras}
        frames |= {name: round(late.seconds * known.fps) for name, late in one.delays.items()}
        first = max(0, -min(frames.values(), default=0))
        end = rows - max(0, max(frames.values(), default=0))
        taken = np.arange(first, end)
        if len(taken) < every:
            where = f"{known.table(one.number)}: {rows} rows"
            raise LogError(f"{where}, and images later than that; none is left")
        # frames of a video of another length than the
        # table are dated by themselves: no row has them
        flags = {
            feature: films[one.number, feature].flags
            for feature in one.repeating
            if films and len(films[one.number, feature].flags) == rows
        }
        if every > 1:
            taken = _least_repeating(taken, every, flags, frames)
        marks_of = {name: film[taken + frames[name]] for name, film in flags.items() if marks}
        yield Edit(
            one.number, new, offset, source_offset, taken, rows, frames, one.delays, marks_of
        )
        offset += len(taken)
        source_offset += rows


_IMAGES = ("video", "image")


def _least_repeating(
    taken: Array, every: int, flags: Mapping[str, Array], frames: Mapping[str, int]
) -> Array:
    """Every n-th row, from the one on with which fewest images repeat."""
    phases = [taken[phase::every] for phase in range(every)]
    counts = [
        sum(int(film[rows + frames[name]].sum()) for name, film in flags.items()) for rows in phases
    ]
    return phases[int(np.argmin(counts))]


def _where(known: DatasetLayout, number: int) -> list[tuple[int, int]]:
    return parquet.find_row_runs(known.table(number), "episode_index", number)


class _Work:
    """The files of one corrected dataset as they are written."""

    def __init__(
        self, known: DatasetLayout, target: DatasetLayout, edits: Sequence[Edit], every: int
    ) -> None:
        self._known = known
        self._target = target
        self._edits = edits
        self._every = every
        self._unchanged = set[int]()
        self.copied = 0
        self.written = 0

    def write_tables(self) -> None:
        """The tables of rows, each with the episodes that the source has in it."""
        sources: dict[Path, list[Edit]] = {}
        for edit in self._edits:
            sources.setdefault(self._known.table(edit.number), []).append(edit)
        for source, edits in sources.items():
            place = self._target.table(edits[0].new) if self._each else self._beside(source)
            held = sum(edit.rows for edit in edits)
            with parquet.open_parquet(source) as file:
                whole = file.metadata.num_rows == held
            if whole and all(edit.is_unchanged for edit in edits):
                self._copy(source, place)
                self._unchanged |= {edit.new for edit in edits}
            else:
                self._write_rows(source, edits, place)

    @property
    def _each(self) -> bool:
        return self._known.one_file_each

    def _beside(self, source: Path) -> Path:
        """The place in the output of a file of the source."""
        return self._target.folder / source.relative_to(self._known.folder)

    def _copy(self, source: Path, place: Path) -> None:
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, place)
        self.copied += 1

    def _write_rows(self, source: Path, edits: Sequence[Edit], place: Path) -> None:
        arrow = require_module("pyarrow", place)
        with parquet.open_parquet(source) as file:
            table = file.read()
        parts = [self._edited(table, edit, arrow) for edit in edits]
        done = arrow.concat_tables(parts)
        place.parent.mkdir(parents=True, exist_ok=True)
        require_module("pyarrow.parquet", place).write_table(done, place, compression="snappy")
        self.written += 1

    def _edited(self, table: Any, edit: Edit, arrow: Any) -> Any:
        """The rows of an episode as they are taken."""
        held = np.concatenate([np.arange(*run) for run in _where(self._known, edit.number)])
        names = list(table.column_names)
        columns = dict[str, Any]()
        for name in names:
            source = table.column(name)
            late = edit.frames.get(name.removesuffix(STAMP), 0)
            columns[name] = source.take(arrow.array(held[edit.taken + late]))
            if name.endswith(STAMP) and (delay := edit.delays.get(name.removesuffix(STAMP))):
                ns = columns[name].to_numpy() - round(delay.seconds * 1e9)
                columns[name] = arrow.array(ns)
        count = len(edit.taken)
        counted = {
            "timestamp": self._timestamps(columns.get("timestamp"), edit),
            "frame_index": np.arange(count),
            "episode_index": np.full(count, edit.new),
            "index": edit.offset + np.arange(count),
        }
        for name in names:
            if counted.get(name) is not None:
                columns[name] = arrow.array(counted[name]).cast(table.schema.field(name).type)
        schema = table.schema
        for feature, flags in edit.repeated.items():
            columns[_mark_name(feature)] = arrow.array(flags)
            schema = schema.append(arrow.field(_mark_name(feature), arrow.bool_()))
        schema = schema.with_metadata(_marked_metadata(schema.metadata, edit.repeated))
        return arrow.table(list(columns.values()), schema=schema)

    def _timestamps(self, taken: Any, edit: Edit) -> Array | None:
        """Times (n,) s at which the videos show the images of the rows: in shared videos they count
        from the episode's begin."""
        if taken is None:
            return None
        t = np.asarray(taken.to_numpy(), float)
        return t + edit.latest / self._known.fps if self._each else t - t[0]

    def write_videos(self) -> None:
        """The videos: copied, or with their images shown later where another camera is later
        still."""
        films = [name for name, one in self._known.features.items() if one.get("dtype") == "video"]
        done = set[Path]()
        for edit in self._edits:
            for name in films:
                source = self._known.video(edit.number, name).path
                if not source.is_file() or (not self._each and source in done):
                    continue
                done.add(source)
                place = (
                    self._target.video(edit.new, name).path if self._each else self._beside(source)
                )
                later = edit.latest - edit.frames[name]
                if later and self._each:
                    place.parent.mkdir(parents=True, exist_ok=True)
                    video.write_later(source, place, later / self._known.fps)
                    self.written += 1
                else:
                    self._copy(source, place)

    def write_meta(self, remedies: Sequence[Remedy]) -> None:
        """info.json, the lists of episodes, statistics, and what was done."""
        meta = self._target.folder / "meta"
        meta.mkdir(exist_ok=True)
        if self._each:
            self._list_episodes()
        else:
            self._list_episode_tables()
        self._write_whole_statistics()
        self._write_json(INFO, self._info())
        out = [one for one in remedies if one.excluded]
        if out:
            lines = [{"episode_index": one.number, "reason": one.excluded} for one in out]
            self._write_lines(EXCLUDED, lines)
        self._write_json(FIXED, {"episodes": [self._edit_as_values(edit) for edit in self._edits]})

    def _edit_as_values(self, edit: Edit) -> dict[str, Any]:
        """What was done to an episode, as plain values."""
        cameras = {
            name: {
                "frames": edit.frames[name],
                "delay_s": late.seconds,
                "std_s": late.std_s,
                "left_s": late.seconds - edit.frames[name] / self._known.fps,
            }
            for name, late in edit.delays.items()
        }
        rows = {"rows": len(edit.taken), "source_rows": edit.rows}
        return {"episode_index": edit.new, "source": edit.number, **rows, "cameras": cameras}

    def _changed_numbers(self, edit: Edit) -> dict[str, Array]:
        """The numbers (n,K) of an episode in the output, by feature; none where all are as
        before."""
        return {} if edit.new in self._unchanged else self._numbers(edit)

    def _numbers(self, edit: Edit) -> dict[str, Array]:
        """The numbers (n,K) of an episode in the output, by feature."""
        path = (
            self._target.table(edit.new)
            if self._each
            else self._beside(self._known.table(edit.number))
        )
        where = parquet.find_row_runs(path, "episode_index", edit.new)
        names = [name for name, one in self._info_features().items() if one["dtype"] not in _IMAGES]
        found = parquet.read_number_columns(path, names, where)
        return {name: values for name, values in found.items() if values is not None}

    def _info_features(self) -> dict[str, Any]:
        features = dict(self._known.info["features"])
        marked = {feature for edit in self._edits for feature in edit.repeated}
        for feature in sorted(marked):
            features[_mark_name(feature)] = {"dtype": "bool", "shape": [1], "names": None}
        return features

    def _info(self) -> dict[str, Any]:
        info = dict(self._known.info)
        count = len(self._edits)
        films = sum(one.get("dtype") == "video" for one in self._known.features.values())
        counted = {
            "total_episodes": count,
            "total_frames": sum(len(edit.taken) for edit in self._edits),
            "total_videos": films * count,
            "splits": {"train": f"0:{count}"},
            "fps": _plain(self._known.fps / self._every),
        }
        size = info.get("chunks_size")
        if isinstance(size, int) and size > 0:
            counted["total_chunks"] = -(-count // size)
        info |= {key: value for key, value in counted.items() if key in info}
        info["features"] = self._info_features()
        return info

    def _list_episodes(self) -> None:
        """The list of episodes before v3.0, and their statistics."""
        rows = [self._known.rows[edit.number] for edit in self._edits]
        listed_rows = [
            {**row, "episode_index": edit.new, "length": len(edit.taken)}
            for row, edit in zip(rows, self._edits, strict=True)
        ]
        self._write_lines(EPISODES, listed_rows)
        stored = _stored_lines(self._known.folder / EPISODE_STATISTICS)
        if stored:
            self._write_lines(EPISODE_STATISTICS, list(self._restated(stored)))

    def _restated(self, stored: Mapping[int, Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
        for edit in self._edits:
            if edit.number in stored:
                row = stored[edit.number]
                stats = dict(row.get("stats") or {})
                for name, values in self._changed_numbers(edit).items():
                    like = stats.get(name) or {}
                    stats[name] = measure_like(values, like)
                yield {**row, "episode_index": edit.new, "stats": stats}

    def _list_episode_tables(self) -> None:
        """The tables of episodes of v3.0, each with the episodes that the source lists in it."""
        arrow = require_module("pyarrow", self._known.folder)
        writer = require_module("pyarrow.parquet", self._known.folder)
        of = {edit.number: edit for edit in self._edits}
        for source in sorted((self._known.folder / EPISODE_TABLES).rglob("*.parquet")):
            with parquet.open_parquet(source) as file:
                table = file.read()
            rows = [row for row in table.to_pylist() if row.get("episode_index") in of]
            if not rows:
                continue
            changed = [self._listed_row(row, of[row["episode_index"]]) for row in rows]
            place = self._beside(source)
            if changed == table.to_pylist():
                self._copy(source, place)
                continue
            place.parent.mkdir(parents=True, exist_ok=True)
            writer.write_table(arrow.Table.from_pylist(changed, schema=table.schema), place)

    def _listed_row(self, row: dict[str, Any], edit: Edit) -> dict[str, Any]:
        count = len(edit.taken)
        fps = self._known.fps
        end = edit.offset + count
        row_numbers = {"episode_index": edit.new, "length": count}
        row_numbers |= {"dataset_from_index": edit.offset, "dataset_to_index": end}
        row = {**row, **{key: value for key, value in row_numbers.items() if key in row}}
        for name, late in edit.frames.items():
            begin, stop = (f"videos/{name}/{side}_timestamp" for side in ("from", "to"))
            if isinstance(row.get(begin), float) and not edit.takes_all:
                row[begin] += (int(edit.taken[0]) + late) / fps
                row[stop] = row[begin] + (int(edit.taken[-1] - edit.taken[0]) + 1) / fps
        for name, values in self._changed_numbers(edit).items():
            begin = f"stats/{name}/"
            like = {key.removeprefix(begin): row[key] for key in row if key.startswith(begin)}
            measured = measure_like(values, like) if like else {}
            row |= {begin + key: value for key, value in measured.items() if begin + key in row}
        return row

    def _write_whole_statistics(self) -> None:
        """stats.json: of the numbers as they are now, of the images as before."""
        path = self._known.folder / STATISTICS
        if not path.is_file():
            return
        stats = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(stats, dict):
            raise FormatError(f"{path}: no statistics by feature")
        if len(self._unchanged) == len(self._edits) == len(self._known.rows):
            self._copy(path, self._target.folder / STATISTICS)
            return
        each = [self._numbers(edit) for edit in self._edits]
        for name, like in stats.items():
            if all(name in one for one in each) and isinstance(like, dict):
                stats[name] = measure_like(np.concatenate([one[name] for one in each]), like)
        self._write_json(STATISTICS, stats)

    def _write_json(self, name: str, content: Mapping[str, Any]) -> None:
        text = json.dumps(content, indent=4, ensure_ascii=False) + "\n"
        self._write_text(name, text, [dict(content)])

    def _write_lines(self, name: str, rows: Sequence[Mapping[str, Any]]) -> None:
        text = "".join(f"{json.dumps(row, ensure_ascii=False)}\n" for row in rows)
        self._write_text(name, text, [dict(row) for row in rows])

    def _write_text(self, name: str, text: str, content: Sequence[Any]) -> None:
        """A text file; that of the source where its content is the same."""
        source = self._known.folder / name
        if source.is_file() and _json_values(source) == list(content):
            self._copy(source, self._target.folder / name)
        else:
            (self._target.folder / name).write_text(text, encoding="utf-8")

    def copy_rest(self) -> None:
        """Files that belong to no episode: licences, cards, tasks; links out of the dataset are
        not followed."""
        folder = self._known.folder
        own = {INFO, EPISODES, EPISODE_STATISTICS, STATISTICS, EXCLUDED, FIXED}
        for path in sorted(folder.rglob("*")):
            name = path.relative_to(folder)
            rows = name.parts[0] in ("data", "videos") or str(name).startswith(EPISODE_TABLES)
            hidden = any(part.startswith(".") for part in name.parts)
            if rows or hidden or str(name) in own or not path.is_file():
                continue
            if is_inside(path, folder):
                self._copy(path, self._target.folder / name)


def _json_values(path: Path) -> list[Any]:
    """The values of a JSON file, or of one of JSON lines."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".json":
        return [json.loads(text)]
    return [json.loads(line) for line in text.splitlines() if line.strip()]


def _stored_lines(path: Path) -> dict[int, Mapping[str, Any]]:
    """The rows of a file of JSON lines by their episodes; none without the file."""
    if not path.is_file():
        return {}
    rows = [row for row in _json_values(path) if isinstance(row, dict)]
    return {row["episode_index"]: row for row in rows if "episode_index" in row}


def _mark_name(feature: str) -> str:
    """The name of the feature that marks repeated frames of a camera."""
    return REPEATED + feature.removeprefix("observation.images.").removeprefix("observation.")


def _marked_metadata(metadata: Any, marked: Mapping[str, Array]) -> dict[bytes, bytes] | None:
    """A table's metadata with the features that mark frames declared, as `datasets` reads them."""
    if not metadata or b"huggingface" not in metadata or not marked:
        return metadata if metadata is None else dict(metadata)
    known = json.loads(metadata[b"huggingface"])
    features = known.get("info", {}).get("features")
    if isinstance(features, dict):
        features |= {_mark_name(name): {"dtype": "bool", "_type": "Value"} for name in marked}
    return {**metadata, b"huggingface": json.dumps(known).encode()}


def _plain(value: float) -> float | int:
    return int(value) if value == int(value) else value


def _require_complete(target: Path, edits: Sequence[Edit]) -> None:
    """FormatError where the dataset that was written does not hold each episode's rows."""
    done = read_dataset_layout(target)
    for edit in edits:
        rows = sum(end - first for first, end in _where(done, edit.new))
        if not done.holds(edit.new) or rows != len(edit.taken):
            raise FormatError(f"{target}: was not written correctly: episode {edit.new}")


def _sentences(
    known: DatasetLayout, remedies: Sequence[Remedy], edits: Sequence[Edit], every: int, work: _Work
) -> Iterator[str]:
    """What was done, for people."""
    left_out = [one for one in remedies if one.excluded]
    yield f"{len(edits)} of {len(remedies)} episodes are kept"
    for one in left_out:
        yield f"episode {one.number} is left out: {one.excluded}"
    for name in sorted({name for edit in edits for name in edit.delays}):
        yield from _delay_sentences(name, known, edits)
    if every > 1:
        fps = known.fps / every
        yield f"one row in {every} is kept: {fps:g} Hz"
    for name in sorted({name for edit in edits for name in edit.repeated}):
        count = sum(int(edit.repeated[name].sum()) for edit in edits if name in edit.repeated)
        rows = sum(len(edit.taken) for edit in edits)
        yield (
            f"{name}: {count} of {rows} frames repeat the one before; {_mark_name(name)} marks them"
        )
    lost = sum(edit.rows for edit in edits) - sum(len(edit.taken) for edit in edits)
    if lost and every == 1:
        yield f"{lost} rows at begins or ends have no image that shows them, and are left out"
    yield f"{work.copied} files are copied byte for byte, {work.written} tables and videos are new"


def _delay_sentences(name: str, known: DatasetLayout, edits: Sequence[Edit]) -> Iterator[str]:
    """By how many frames a camera's images were moved."""
    groups: dict[tuple[int, CameraDelay], list[str]] = {}
    for edit in edits:
        if name in edit.delays:
            key = (edit.frames[name], edit.delays[name])
            groups.setdefault(key, []).append(str(edit.number))
    for (frames, late), numbers in groups.items():
        size = f"{1e3 * late.seconds:.0f} ± {1e3 * late.std_s:.0f} ms late"
        where = (
            f"in episode {list_in_words(numbers)}" if late.own else f"in {len(numbers)} episodes"
        )
        if not frames:
            yield f"{name}: {size} {where}: less than half a frame, left as it is"
            continue
        rest = late.seconds - frames / known.fps
        left = f"{1e3 * rest:.0f} ± {1e3 * late.std_s:.0f} ms are left"
        yield f"{name}: {size} {where}: each row has the image {frames} frames on; {left}"

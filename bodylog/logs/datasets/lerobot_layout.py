"""The layout of a LeRobot dataset (v2.0, v2.1, v3.0):
meta/info.json, list of episodes, tables and videos.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from ...errors import FormatError, LogError
from ...io.contained import is_inside
from ...io.values import number_in_64_bits, read_json
from . import parquet

INFO = "meta/info.json"
EPISODES = "meta/episodes.jsonl"
TASKS = "meta/tasks.jsonl"
EPISODE_STATISTICS = "meta/episodes_stats.jsonl"
STATISTICS = "meta/stats.json"
EPISODE_TABLES = "meta/episodes"
TASK_TABLE = "meta/tasks.parquet"
_MOST_BYTES = 64 << 20
_MOST_FEATURES = 1000
_PLACE = re.compile(r"\{(\w+)(?::0?(\d{1,2})d)?\}")


@dataclass(frozen=True, eq=False)
class EpisodePart:
    """The place of a piece of an episode: a file, and in a shared video its start and end (s)."""

    path: Path
    start: float = 0.0
    end: float | None = None


@dataclass(frozen=True, eq=False)
class DatasetLayout:
    """A dataset: its folder, info.json, features {name:
    declaration}, frames per second, and the episodes' rows.

    `rows` {episode: its entry in the dataset's list}, the last one of the `repeated` episodes.
    """

    folder: Path
    info: Mapping[str, Any]
    features: Mapping[str, Mapping[str, Any]]
    fps: float
    rows: Mapping[int, Mapping[str, Any]]
    repeated: frozenset[int] = frozenset()

    @property
    def version(self) -> str:
        """v2.0, v2.1 or v3.0."""
        return str(self.info.get("codebase_version", ""))

    @property
    def one_file_each(self) -> bool:
        """Whether each episode has its own files, as before v3.0."""
        return not self.version.startswith("v3")

    def table(self, episode: int) -> Path:
        """The Parquet file with the rows of an episode."""
        return self._path("data_path", self._keys(episode, "data"))

    def video(self, episode: int, feature: str) -> EpisodePart:
        """The video of a camera in an episode."""
        keys = {**self._keys(episode, f"videos/{feature}"), "video_key": feature}
        path = self._path("video_path", keys)
        if self.one_file_each:
            return EpisodePart(path)
        row = self.rows[episode]
        name = f"videos/{feature}"
        start, end = (
            _finite_number_or_none(row.get(f"{name}/{side}_timestamp")) for side in ("from", "to")
        )
        return EpisodePart(path, start or 0.0, end)

    def present(self) -> tuple[int, ...]:
        """The episodes whose tables exist."""
        return tuple(number for number in sorted(self.rows) if self.holds(number))

    def holds(self, episode: int) -> bool:
        """Whether an episode is listed and its table exists."""
        try:
            return episode in self.rows and self.table(episode).is_file()
        except FormatError:
            return False

    def _keys(self, episode: int, what: str) -> dict[str, int | str]:
        size = self.info.get("chunks_size")
        chunk = episode // size if isinstance(size, int) and size > 0 else 0
        if self.one_file_each:
            return {"episode_index": episode, "episode_chunk": chunk, "chunk_index": chunk}
        row = self.rows[episode]
        found = {name: row.get(f"{what}/{name}") for name in ("chunk_index", "file_index")}
        if not all(isinstance(value, int) for value in found.values()):
            raise FormatError(
                f"{self.folder}: episode {episode}: {EPISODE_TABLES} does not list the file "
                f"of {what}"
            )
        return {
            "episode_index": episode,
            **{name: int(value or 0) for name, value in found.items()},
        }

    def _path(self, key: str, values: Mapping[str, int | str]) -> Path:
        """A path of info.json with its placeholders filled
        in; FormatError if it leads out of the folder.
        """
        template = self.info.get(key)
        if not isinstance(template, str):
            raise FormatError(
                f"{self.folder}/{INFO}: {key} is {template!r:.60}; a path is expected"
            )

        def filled(place: "re.Match[str]") -> str:
            if (value := values.get(place[1])) is None:
                raise FormatError(
                    f"{self.folder}/{INFO}: {key}: {place[0]}; possible: {', '.join(values)}"
                )
            return f"{value:0{place[2]}d}" if place[2] and isinstance(value, int) else str(value)

        text = _PLACE.sub(filled, template)
        path = Path(text)
        if path.is_absolute() or ".." in path.parts or "{" in text or "\0" in text:
            raise FormatError(
                f"{self.folder}/{INFO}: {key} = {template!r:.80} is not a path within the dataset"
            )
        return _require_inside_dataset(self.folder / path, self.folder)


def read_dataset_layout(folder: Path) -> DatasetLayout:
    """The layout of a dataset; FormatError or LogError for broken meta files."""
    path = _require_inside_dataset(folder / INFO, folder)
    if not path.is_file():
        raise LogError(f"{path}: there is no such file; is the dataset downloaded completely?")
    info = path.stat()
    tables = _episode_tables(folder)
    listed = [path.stat() for path in (folder / EPISODES, *tables) if path.is_file()]
    return _read_cached_layout(folder, *((one.st_mtime_ns, one.st_size) for one in (info, *listed)))


def _episode_tables(folder: Path) -> list[Path]:
    return [
        _require_inside_dataset(path, folder)
        for path in sorted((folder / EPISODE_TABLES).rglob("*.parquet"))
    ]


def _require_inside_dataset(path: Path, folder: Path) -> Path:
    """The path; FormatError where a link leads out of the dataset."""
    if not is_inside(path, folder):
        raise FormatError(f"{path}: is a link out of the dataset; copy the file in its place")
    return path


@lru_cache(maxsize=4)
def _read_cached_layout(folder: Path, *_: tuple[int, int]) -> DatasetLayout:
    """As `read_dataset_layout`, cached while the files do not change."""
    path = folder / INFO
    info = _read_meta_json(path)
    features = info.get("features") if isinstance(info, dict) else None
    if not isinstance(features, dict) or len(features) > _MOST_FEATURES:
        raise FormatError(f"{path}: no LeRobot info.json: features is {type(features).__name__}")
    version = str(info.get("codebase_version", ""))
    if not re.match(r"v[23]\.\d", version):
        raise LogError(f"{path}: codebase_version is {version!r:.40}; v2.0, v2.1 and v3.0 are read")
    fps = _finite_number_or_none(info.get("fps"))
    if fps is None or not 0 < fps <= 1e5:
        raise FormatError(f"{path}: fps is {info.get('fps')!r:.40}; frames per second are expected")
    known = {
        str(name): declared for name, declared in features.items() if isinstance(declared, dict)
    }
    listed = _list_v3_episodes(folder) if version.startswith("v3") else _list_v2_episodes(folder)
    numbered = [row for row in listed if _is_index(row.get("episode_index"))]
    times_listed = Counter(row["episode_index"] for row in numbered)
    repeated = frozenset(number for number, times in times_listed.items() if times > 1)
    rows = {row["episode_index"]: row for row in numbered}
    return DatasetLayout(folder, info, known, fps, rows, repeated)


def stored_statistics(layout: DatasetLayout) -> tuple[dict[int, Any], Any]:
    """Statistics as the dataset's files have them: {episode: {feature: …}}, and of the whole; empty
    without a file."""
    folder = layout.folder
    each = folder / EPISODE_STATISTICS
    whole = folder / STATISTICS
    rows = _read_meta_json_lines(each) if each.is_file() else []
    numbered = [row for row in rows if _is_index(row.get("episode_index"))]
    by_episode = {row["episode_index"]: row.get("stats") for row in numbered}
    return by_episode, _read_meta_json(whole) if whole.is_file() else {}


def read_task_texts(layout: DatasetLayout) -> dict[int, str]:
    """The texts of the tasks by index; empty if the dataset lists none."""
    folder = layout.folder
    if layout.one_file_each:
        found = _read_meta_json_lines(folder / TASKS) if (folder / TASKS).is_file() else []
        pairs = [(row.get("task_index"), row.get("task")) for row in found]
    elif (folder / TASK_TABLE).is_file():
        table = parquet.read_object_columns(
            _require_inside_dataset(folder / TASK_TABLE, folder),
            ("task_index", "task", "__index_level_0__"),
        )
        names = table.get("task") or table.get("__index_level_0__") or []
        pairs = list(zip(table.get("task_index", []), names, strict=False))
    else:
        pairs = []
    return {
        index: str(text)
        for index, text in pairs
        if isinstance(index, int) and isinstance(text, str)
    }


def _list_v2_episodes(folder: Path) -> Sequence[Mapping[str, Any]]:
    path = folder / EPISODES
    if not path.is_file():
        raise LogError(f"{path}: there is no such file; is the dataset downloaded completely?")
    return _read_meta_json_lines(path)


_COLUMNS = ("episode_index", "tasks", "length", "data/chunk_index", "data/file_index")


def _list_v3_episodes(folder: Path) -> Sequence[Mapping[str, Any]]:
    found = list[Mapping[str, Any]]()
    tables = _episode_tables(folder)
    if not tables:
        raise LogError(
            f"{folder / EPISODE_TABLES}: there are no tables; is the dataset downloaded completely?"
        )
    for path in tables:
        with parquet.open_parquet(path) as file:
            names = [
                name
                for name in file.schema_arrow.names
                if name in _COLUMNS or name.startswith("videos/")
            ]
        columns = parquet.read_object_columns(path, names)
        rows = zip(*columns.values(), strict=True)
        found += [dict(zip(columns, cells, strict=True)) for cells in rows]
    return found


def _is_index(value: Any) -> bool:
    return isinstance(value, int) and 0 <= value < 10**9


def _finite_number_or_none(value: Any) -> float | None:
    """A finite number, or None."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    found = float(number_in_64_bits(value))
    return found if found - found == 0 else None


def _read_meta_text(path: Path) -> str:
    size = _require_inside_dataset(path, path.parent.parent).stat().st_size
    if size > _MOST_BYTES:
        raise LogError(f"{path}: {size} bytes; at most {_MOST_BYTES} are read")
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise FormatError(f"{path}: this is not UTF-8 text") from None


def _read_meta_json(path: Path) -> Any:
    try:
        return read_json(_read_meta_text(path))
    except ValueError as problem:
        raise FormatError(f"{path}: this is not JSON: {problem}") from None


def _read_meta_json_lines(path: Path) -> Sequence[Mapping[str, Any]]:
    """The objects of a file of JSON lines; FormatError for an invalid line."""
    found = []
    for number_, line in enumerate(_read_meta_text(path).splitlines(), 1):
        if line.strip():
            try:
                row = read_json(line)
            except ValueError as problem:
                raise FormatError(f"{path}: line {number_} is not JSON: {problem}") from None
            if not isinstance(row, dict):
                raise FormatError(f"{path}: line {number_} is not a JSON object")
            found.append(row)
    return found

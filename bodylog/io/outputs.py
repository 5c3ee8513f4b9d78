"""The guard of outputs: no command writes to anything that it reads, whatever name is used."""

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ..errors import UsageError
from . import episodes

Key = tuple[int, int]
"""Device and inode: the same for all names of a file or folder, also on case-insensitive disks."""

METADATA = "metadata.yaml"
RECORDED = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd", ".db3.zst", ".mcap.zst")
"""Suffixes of the files of a rosbag2 folder."""
BESIDE = ("-wal", "-journal", "-shm")
"""Files that SQLite keeps beside a .db3."""


@dataclass(frozen=True)
class Output:
    """An output: a file, or with `folder` a folder for files; and the option that named it."""

    path: Path
    option: str = "-o"
    folder: bool = False

    def __str__(self) -> str:
        """The output as typed."""
        return f"{self.option} {self.path}"


def guard_outputs(inputs: Iterable[Path], outputs: Iterable[Output]) -> None:
    """UsageError when an output is an input, lies inside
    one or contains one, or when two outputs are the same.

    Paths are compared on disk (links, hard links, case, mounts), not by
    name. A folder as input includes its content and targets of links in
    it; a file of a rosbag2 folder includes the whole recording.
    """
    outputs = list(outputs)
    inputs = list(inputs)
    for output in outputs:
        place = _Place(output)
        for given in map(episodes.dataset_path, inputs):
            for part in _input_parts(given):
                place.refuse(part, given)
    for first in outputs:
        for second in outputs:
            if (
                first is not second
                and not first.folder
                and _paths_behind(first.path) in _symlink_chain(_paths_behind(second.path))
            ):
                raise UsageError(
                    f"{second} and {first} are the same; give each output its own path"
                )


class _Place:
    """An output's location on disk."""

    def __init__(self, output: Output) -> None:
        self._output = output
        self._real = _paths_behind(output.path)
        self._key = path_identity(self._real)
        self._above = {
            found
            for path in _symlink_chain(self._real)
            if (found := path_identity(path)) is not None
        }
        self._within = set(_folder_link_targets(self._real)) if output.folder else set()

    def refuse(self, part: Path, given: Path) -> None:
        """UsageError when this output is `part`, which
        belongs to the input `given`, or inside or around it.
        """
        found = path_identity(part)
        real = _paths_behind(part) if found is None or part is given or part.is_symlink() else None
        if real == self._real or (found is not None and found == self._key):
            relation = "is also an input" if part is given else f"is {part.name} of an input"
            raise UsageError(f"{self._output} {relation} ({given}); choose another name")
        if found is None:
            return
        if found in self._above:
            raise UsageError(
                f"{self._output} lies inside an input ({given}); choose a place outside of it"
            )
        around = (
            self._key is not None
            and real is not None
            and self._key in map(path_identity, real.parents)
        )
        if around or found in self._within:
            raise UsageError(f"{self._output} holds an input ({given}); choose another folder")


def path_identity(path: Path) -> Key | None:
    """Identity of a path's target; None if it does not exist."""
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return None
    return found.st_dev, found.st_ino


def _paths_behind(path: Path) -> Path:
    return Path(os.path.realpath(path))


def _symlink_chain(path: Path) -> tuple[Path, ...]:
    return path, *path.parents


def _folder_link_targets(folder: Path) -> Iterator[Key]:
    """Targets of the names in a folder: an output may be a link or one of a file's names."""
    try:
        names = list(folder.iterdir())
    except OSError:
        return
    yield from (found for name in names if (found := path_identity(name)) is not None)


def _input_parts(given: Path) -> Iterator[Path]:
    """An input, and everything that is read with it."""
    yield given
    if given.is_dir():
        yield from _walk_folder(given)
        return
    yield from (given.with_name(given.name + end) for end in BESIDE if given.suffix == ".db3")
    for folder in {given.parent, _paths_behind(given).parent}:
        if given.name.endswith(RECORDED) and (folder / METADATA).is_file():
            yield from (
                path
                for path in folder.iterdir()
                if path.name == METADATA or path.name.endswith(RECORDED)
            )


def _walk_folder(folder: Path) -> Iterator[Path]:
    """Everything in a folder, links followed; each folder once."""
    seen = set[Key | None]((None,))
    left = [folder]
    while left:
        found = path_identity(path := left.pop())
        if found in seen:
            continue
        seen.add(found)
        try:
            names = list(path.iterdir())
        except OSError:
            continue
        yield from names
        left += [name for name in names if name.is_dir()]

"""Open HDF5 files with episodes, and find the datasets of one episode."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import FormatError, LogError
from ...io.values import read_json
from ..records import Finding
from .extra import require_module

MAGIC = b"\x89HDF\r\n\x1a\n"
_MOST_SETS = 2000
_DEEPEST = 6
_DEMO = re.compile(r"demo_(\d{1,9})$")


@dataclass(frozen=True, eq=False)
class Sets:
    """The datasets of one group by their path in it, and the rate if the file declares it (Hz)."""

    group: str
    sets: Mapping[str, Any]
    rate: float | None
    format: str


def numbers(file: Path) -> tuple[int, ...]:
    """The numbers of a file's demonstrations; empty if it holds a single episode."""
    with opened(file) as one:
        return _demos(one)


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open an HDF5 file; FormatError when it is damaged or becomes unreadable."""
    h5py = require_module("h5py", path)
    try:
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, RuntimeError, KeyError, ValueError) as problem:
        text = " ".join(str(problem).split())[:160]
        raise FormatError(f"{path}: the HDF5 file cannot be read: {text}") from None


def _demos(file: Any) -> tuple[int, ...]:
    data = _member(file, "data")
    names = list(data.keys())[:1_000_000] if data is not None and hasattr(data, "keys") else []
    return tuple(sorted(int(match[1]) for name in names if (match := _DEMO.fullmatch(name))))


def sets_of(file: Any, path: Path, number: int | None, findings: list[Finding]) -> Sets:
    """The datasets of the episode; LogError if that episode, or any, is missing."""
    demos = _demos(file)
    if not demos:
        if number:
            raise LogError(f"{path}: no episode {number}; the file holds one, number 0")
        rate = _rate(attribute(file, "fps")) or _rate(attribute(file, "hz"))
        return Sets("", _walk(file), rate, "hdf5")
    asked, number = number, demos[0] if number is None else number
    if number not in demos:
        some = ", ".join(map(str, demos[:12]))
        raise LogError(f"{path}: no episode {number}; possible: {some}{' …' if len(demos) > 12 else ''}")
    if asked is None and len(demos) > 1:
        some = f"episode {number}, the first of {len(demos)}; for another, type: --episode {demos[1]}"
        findings.append(Finding("info", some))
    group = f"data/demo_{number}"
    return Sets(group, _walk(file[group]), _control_rate(file["data"]), "robomimic")


def _walk(group: Any, before: str = "", depth: int = 0) -> dict[str, Any]:
    """The datasets below a group that are in the file itself: no links, no external data."""
    found: dict[str, Any] = {}
    for name in list(group.keys())[:_MOST_SETS]:
        one = _member(group, name)
        if one is None:
            continue
        if hasattr(one, "keys"):
            found |= _walk(one, f"{before}{name}/", depth + 1) if depth < _DEEPEST else {}
        elif _is_own(one):
            found[f"{before}{name}"] = one
    if len(found) > _MOST_SETS:
        raise ValueError(f"more than {_MOST_SETS} datasets in one episode")
    return found


def _is_own(one: Any) -> bool:
    """Whether this is a dataset of a NumPy type with its data in the file."""
    try:
        return one.dtype is not None and one.shape is not None and not one.is_virtual and not one.external
    except (AttributeError, TypeError):
        return False


def attribute(one: Any, name: str) -> Any:
    """An attribute, or None if NumPy does not know its type."""
    try:
        return one.attrs.get(name)
    except (TypeError, OSError, RuntimeError, ValueError):
        return None


def _member(group: Any, name: str) -> Any:
    """The object of that name, unless it is a link out of the file."""
    if name not in group:
        return None
    link = group.get(name, getlink=True)
    return group[name] if type(link).__name__ == "HardLink" else None


def _rate(value: Any) -> float | None:
    try:
        found = float(value)
    except (TypeError, ValueError):
        return None
    return found if 0 < found < 1e6 else None


def _control_rate(data: Any) -> float | None:
    """The control frequency of robomimic's env_args."""
    stored = attribute(data, "env_args")
    try:
        args = read_json(stored) if isinstance(stored, str | bytes) else {}
        return _rate(args["env_kwargs"]["control_freq"])
    except (ValueError, KeyError, TypeError):
        return None

"""Read a table from a CSV, Parquet or YAML file as columns of numbers or texts; unreadable parts are counted."""

import csv
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError, LogError, UsageError
from ..records import Array

SUFFIXES = {".csv": "csv", ".tsv": "csv", ".parquet": "parquet", ".yaml": "yaml", ".yml": "yaml"}
EMPTY = frozenset(("", "nan", "na", "n/a", "null", "none", "-"))
"""Cells, in lower case, that count as empty."""
_MOST_BYTES = {"csv": 256 << 20, "parquet": 256 << 20, "yaml": 8 << 20}
_MOST_CELLS = 1 << 26
_MOST_COLUMNS = 10_000
_BLOCK = 4096
_MISTYPED = 0.5
"""Share of a column's filled cells that must be numbers for a column of numbers."""


@dataclass(frozen=True, eq=False)
class Table:
    """numbers {column: (N,) float64, NaN where empty} · texts {column: (N,) object} · number of rows · notes.

    `lost`: notes on unreadable rows; `odd`: on cells without a number in a column of numbers.
    """

    numbers: Mapping[str, Array]
    texts: Mapping[str, Array]
    rows: int
    lost: tuple[str, ...] = ()
    odd: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all columns."""
        return (*self.numbers, *self.texts)


def kind(path: Path, first: bytes = b"") -> str | None:
    """The format of a table by the file's first bytes and its name: csv, parquet or yaml; None for other files."""
    if first.startswith(b"PAR1"):
        return "parquet"
    return SUFFIXES.get(path.suffix.lower())


def read(path: Path, form: str) -> Table:
    """Read the table in a file of that format; LogError or FormatError if it is invalid."""
    size = path.stat().st_size
    if size > _MOST_BYTES[form]:
        raise LogError(f"{path}: a table of {size} bytes; at most {_MOST_BYTES[form]} are read")
    try:
        found = READERS[form](path)
    except (UnicodeDecodeError, csv.Error, ValueError) as problem:
        raise FormatError(f"{path}: not a {form} table: {_line(problem)}") from None
    if not found.rows:
        raise LogError(f"{path}: the table has no rows")
    return found


def _csv(path: Path) -> Table:
    with path.open(encoding="utf-8-sig", newline="") as stream:
        rows = csv.reader(stream, delimiter=_delimiter(path))
        header = _header([cell.strip() for cell in next(rows, [])], path)
        return _joined(header, _blocks(header, rows), path)


def _delimiter(path: Path) -> str:
    """The most frequent separator in the first line."""
    with path.open(encoding="utf-8-sig") as stream:
        line = stream.readline(1 << 20)
    return max(",;\t", key=line.count)


def _header(names: list[str], path: Path) -> list[str]:
    """The names of the columns; FormatError when they are missing or not unique."""
    if not any(names):
        raise FormatError(f"{path}: the table has no header; name its columns in the first line")
    if all(_is_number(name) for name in names if name):
        raise FormatError(f"{path}: the first line holds numbers ({', '.join(names[:3])}); it must name the columns")
    if len(names) > _MOST_COLUMNS:
        raise FormatError(f"{path}: {len(names)} columns; at most {_MOST_COLUMNS} are read")
    if twice := next((name for name, count in Counter(filter(None, names)).items() if count > 1), None):
        raise FormatError(f"{path}: column {twice!r} occurs {names.count(twice)} times; give each a unique name")
    return names


@dataclass(frozen=True, eq=False)
class _Piece:
    """Some rows: per column numbers (n,), or None if most are texts, the texts (n,), number of rejected rows."""

    cells: Sequence[Array]
    short: int
    long: int


def _blocks(header: Sequence[str], rows: Iterator[list[str]]) -> Iterator[_Piece]:
    """Rows in blocks, so that memory holds only part of a long table's texts; empty lines are skipped."""
    width, block, short, long, cells = len(header), list[list[str]](), 0, 0, 0
    for row in rows:
        if not any(row):
            continue
        if len(row) > width:
            long += 1
            continue
        short += len(row) < width
        cells += width
        if cells > _MOST_CELLS:
            raise ValueError(f"more than {_MOST_CELLS} cells")
        block.append(row + [""] * (width - len(row)))
        if len(block) == _BLOCK:
            yield _Piece(_columns(block, width), short, long)
            block, short, long = [], 0, 0
    yield _Piece(_columns(block, width), short, long)


def _columns(block: list[list[str]], width: int) -> list[Array]:
    """Cells of a block by column: floats (n,) if all filled ones are numbers, else texts (n,) as objects."""
    if not block:
        return [np.empty(0) for _ in range(width)]
    return [_numbers([cell.strip() for cell in column]) for column in zip(*block, strict=True)]


def _numbers(cells: Sequence[str]) -> Array:
    try:
        return np.array([np.nan if cell.lower() in EMPTY else float(cell) for cell in cells])
    except ValueError:
        return np.array(cells, dtype=object)


def _joined(header: Sequence[str], pieces: Iterator[_Piece], path: Path) -> Table:
    parts = list(pieces)
    numbers, texts, odd = dict[str, Array](), dict[str, Array](), []
    for place, name in enumerate(header):
        column = [part.cells[place] for part in parts]
        if not name:
            continue
        values, wrong = _typed(column)
        if values.dtype == object:
            texts[name] = values
        else:
            numbers[name] = values
            odd += [f"column {name}: {len(wrong)} cells are not finite numbers, e.g. {wrong[0]!r}"] if wrong else []
    short, long = sum(part.short for part in parts), sum(part.long for part in parts)
    lost = [f"{long} rows have more than {len(header)} cells and are left out"] if long else []
    lost += [f"{short} rows have fewer than {len(header)} cells; missing cells are empty"] if short else []
    return Table(numbers, texts, sum(len(part.cells[0]) for part in parts), tuple(lost), tuple(odd))


def _typed(column: Sequence[Array]) -> tuple[Array, list[str]]:
    """A column as numbers, with its cells that are not numbers; as texts if most cells are texts."""
    if all(part.dtype != object for part in column):
        values = np.concatenate(column)
        wrong = [str(value) for value in values[np.isinf(values)].tolist()]
        return np.where(np.isfinite(values), values, np.nan), wrong
    cells = np.concatenate([part.astype(object) for part in column])
    numbers = np.array([_number(cell) for cell in cells.tolist()])
    filled = np.array([c == c and _text(c).lower() not in EMPTY for c in cells.tolist()])
    sound = np.isfinite(numbers)
    if sound.sum() <= _MISTYPED * filled.sum():
        return np.array([_text(cell) for cell in cells.tolist()], dtype=object), []
    return np.where(sound, numbers, np.nan), [_text(cell) for cell in cells[filled & ~sound].tolist()]


def _text(cell: Any) -> str:
    """A cell as text; an empty one, however its block stores it, is the empty text."""
    return "" if isinstance(cell, float) and cell != cell else str(cell)


def _number(cell: Any) -> float:
    try:
        return float(cell)
    except (ValueError, TypeError, OverflowError):
        return float("nan")


def _is_number(cell: str) -> bool:
    return cell.lower() not in EMPTY and _number(cell) == _number(cell)


def _parquet(path: Path) -> Table:
    try:
        parquet: Any = import_module("pyarrow.parquet")
    except ImportError:
        text = 'Parquet needs pyarrow; type: pip install "bodylog[parquet]", or save it as CSV'
        raise UsageError(f"{path}: {text}") from None
    with parquet.ParquetFile(path) as file:
        names = _header(list(file.schema_arrow.names), path)
        if file.metadata.num_rows * len(names) > _MOST_CELLS:
            raise LogError(f"{path}: {file.metadata.num_rows} rows of {len(names)} columns; too many for a table")
        table = file.read()
    columns = [(name, table.column(place)) for place, name in enumerate(names)]
    flat = [pair for name, column in columns for pair in _arrow(name, column)]
    return _of_cells([name for name, _ in flat], [cells for _, cells in flat], table.num_rows, path)


def _arrow(name: str, column: Any) -> Iterator[tuple[str, Array]]:
    """A Parquet column as a table column; a list of fixed length as several: name.0, name.1, ..."""
    types: Any = import_module("pyarrow.types")
    if types.is_floating(column.type) or types.is_integer(column.type) or types.is_boolean(column.type):
        yield name, column.cast("float64").to_numpy()
        return
    cells = column.to_pylist()
    widths = {len(cell) for cell in cells if isinstance(cell, list)}
    if len(widths) == 1 and all(isinstance(cell, list) for cell in cells):
        yield from ((f"{name}.{k}", _objects([cell[k] for cell in cells])) for k in range(min(widths)))
    else:
        yield name, _objects(cells)


def _objects(cells: Sequence[Any]) -> Array:
    """Cells (n,) as a CSV column would hold them."""
    plain = [np.nan if cell is None else cell for cell in cells]
    if all(isinstance(cell, int | float) for cell in plain):
        return np.array([_number(cell) for cell in plain])
    out = np.empty(len(plain), dtype=object)
    out[:] = [cell if isinstance(cell, float) else str(cell) for cell in plain]
    return out


def _yaml(path: Path) -> Table:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    text = path.read_text(encoding="utf-8-sig")
    if "*" in text and any(word.startswith("*") for word in text.split()):
        raise ValueError("it has aliases (*name); write the values out")
    try:
        rows = YAML(typ="safe", pure=True).load(text)
    except (YAMLError, RecursionError) as problem:
        raise ValueError(_line(problem)) from None
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise ValueError("it must be a list of mappings, one for each pose: - {pan: 0.1, tip_u: 310.5, tip_v: 99}")
    flat = [dict(_flat(row)) for row in rows]
    names = _header(list(dict.fromkeys(name for row in flat for name in row)), path)
    if len(names) * len(flat) > _MOST_CELLS:
        raise ValueError(f"more than {_MOST_CELLS} cells")
    return _of_cells(names, [_objects([row.get(name) for row in flat]) for name in names], len(rows), path)


def _flat(row: Mapping[Any, Any], before: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """The cells of one mapping, inner ones under the outer's: `tip: {u: 3, v: 4}` or `tip: [3, 4]` is tip_u, tip_v."""
    for key, value in row.items():
        name = f"{before}{key}"
        if isinstance(value, dict) and depth < 4:
            inner = "" if name in ("joints", "position", "positions") else f"{name}_"
            yield from _flat(value, inner, depth + 1)
        elif isinstance(value, list) and len(value) == 2 and all(isinstance(v, int | float) for v in value):
            yield from zip((f"{name}_u", f"{name}_v"), value, strict=True)
        else:
            yield name, value


def _of_cells(names: Sequence[str], cells: Sequence[Array], rows: int, path: Path) -> Table:
    found = _joined(names, iter([_Piece(cells, 0, 0)]), path)
    return Table(found.numbers, found.texts, rows, found.lost, found.odd)


def _line(problem: Exception) -> str:
    return " ".join(str(problem).split())[:200]


READERS: Mapping[str, Callable[[Path], Table]] = {"csv": _csv, "parquet": _parquet, "yaml": _yaml}

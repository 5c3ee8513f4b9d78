"""Read a table from a CSV, Parquet or YAML file as
columns of numbers or texts; unreadable parts are counted.
"""

import csv
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from ...errors import FormatError, LogError
from ...io import yaml_text
from ...io.extras import require_module
from ..limits import LIMITS, Input, TableSize
from ..records import Array
from . import parquet_pages

SUFFIXES = {".csv": "csv", ".tsv": "csv", ".parquet": "parquet", ".yaml": "yaml", ".yml": "yaml"}
_LONGEST_ROW = 1 << 22
"""Characters of a row of a CSV file, which is a list of cells before they can be counted."""
_BLOCK_CELLS = 1 << 17
"""Cells of a CSV file that are texts at one time: each takes some 60 bytes."""
_MISTYPED = 0.5
"""Share of a column's filled cells that must be numbers for a column of numbers."""
EMPTY = frozenset(("", "nan", "na", "n/a", "null", "none", "-"))
"""Cells, in lower case, that count as empty."""
OBJECT_BYTES = 64
"""What a value takes as a Python object, beside its text."""
_MOST_COLUMNS = 10_000


@dataclass(frozen=True, eq=False)
class FileTable:
    """numbers {column: (N,) float64, NaN where empty} ·
    texts {column: (N,) object} · number of rows · notes.

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


def table_format(path: Path, first: bytes = b"") -> str | None:
    """The format of a table by the file's first bytes and
    its name: csv, parquet or yaml; None for other files.
    """
    if first.startswith(b"PAR1"):
        return "parquet"
    return SUFFIXES.get(path.suffix.lower())


def read_table_file(path: Path, form: str, limits: Input = LIMITS) -> FileTable:
    """Read the table in a file of that format; LogError
    or FormatError if it is invalid or beyond the limits.
    """
    name = "max_yaml_mb" if form == "yaml" else "max_table_mb"
    megabytes = path.stat().st_size / 1e6
    if megabytes > getattr(limits, name):
        asked = f"to read it, type in robot.toml: [input] {name} = {math.ceil(megabytes)}"
        raise LogError(f"{path}: a table of {megabytes:.1f} MB; {asked}")
    try:
        found = READERS[form](path, limits)
    except (csv.Error, ValueError) as problem:
        raise FormatError(f"{path}: not a {form} table: {exception_line(problem)}") from None
    if not found.rows:
        raise LogError(f"{path}: the table has no rows")
    return found


def _read_csv(path: Path, limits: Input) -> FileTable:
    with path.open(encoding="utf-8-sig", newline="") as stream:
        rows = _iterate_csv_rows(stream, _detect_delimiter(path))
        header = column_names([cell.strip() for cell in next(rows, [])], path)
        return _join_table_pieces(
            header, _group_csv_rows(header, rows, path, TableSize(limits)), path
        )


def _iterate_csv_rows(stream: TextIO, delimiter: str) -> Iterator[list[str]]:
    """The rows of a CSV file; ValueError for one of more than _LONGEST_ROW characters."""
    left = _LONGEST_ROW

    def lines() -> Iterator[str]:
        nonlocal left
        while line := stream.readline(left + 1):
            left -= len(line)
            if left < 0:
                raise ValueError(f"a row of more than {_LONGEST_ROW} characters")
            yield line

    for row in csv.reader(lines(), delimiter=delimiter):
        left = _LONGEST_ROW
        yield row


def _detect_delimiter(path: Path) -> str:
    """The most frequent separator in the first line."""
    with path.open(encoding="utf-8-sig") as stream:
        line = stream.readline(1 << 20)
    return max(",;\t", key=line.count)


@dataclass(frozen=True, eq=False)
class _TablePiece:
    """Some rows: per column numbers (n,), or None if most
    are texts, the texts (n,), number of rejected rows.
    """

    cells: Sequence[Array]
    short: int
    long: int


def _group_csv_rows(
    header: Sequence[str], rows: Iterator[list[str]], path: Path, size: TableSize
) -> Iterator[_TablePiece]:
    """Rows in blocks, so that memory holds only part
    of a long table's texts; empty lines are skipped.
    """
    width = len(header)
    short = 0
    long = 0
    most = max(1, _BLOCK_CELLS // width)
    block: list[list[str]] = []
    for row in rows:
        if not any(row):
            continue
        if len(row) > width:
            long += 1
            continue
        short += len(row) < width
        block.append(row + [""] * (width - len(row)))
        if len(block) == most:
            yield _build_table_piece(block, width, short, long, path, size)
            block = []
            short = 0
            long = 0
    yield _build_table_piece(block, width, short, long, path, size)


def _build_table_piece(
    block: list[list[str]], width: int, short: int, long: int, path: Path, size: TableSize
) -> _TablePiece:
    """A block of rows as columns; LogError where the table becomes too large."""
    columns = _split_columns(block, width)
    texts = [cell for column in columns if column.dtype == object for cell in column.tolist()]
    size.take(
        8 * len(block) * width + OBJECT_BYTES * len(texts) + sum(map(len, texts)),
        f"{path}: the cells",
    )
    return _TablePiece(columns, short, long)


def _split_columns(block: list[list[str]], width: int) -> list[Array]:
    """Cells of a block by column: floats (n,) if all
    filled ones are numbers, else texts (n,) as objects.
    """
    if not block:
        return [np.empty(0) for _ in range(width)]
    return [_cells_as_numbers(column) for column in zip(*block, strict=True)]


def _cells_as_numbers(column: Sequence[str]) -> Array:
    try:
        return np.fromiter(map(float, column), float, len(column))
    except ValueError:
        cells = [cell.strip() for cell in column]
    try:
        return np.array([np.nan if cell.lower() in EMPTY else float(cell) for cell in cells])
    except ValueError:
        return np.array(cells, dtype=object)


def _join_table_pieces(
    header: Sequence[str], pieces: Iterator[_TablePiece], path: Path
) -> FileTable:
    parts = list(pieces)
    numbers = dict[str, Array]()
    texts = dict[str, Array]()
    odd = []
    for place, name in enumerate(header):
        column = [part.cells[place] for part in parts]
        if not name:
            continue
        values, wrong = _type_column(column)
        if values.dtype == object:
            texts[name] = values
        else:
            numbers[name] = values
            odd += (
                [f"column {name}: {len(wrong)} cells are not finite numbers, e.g. {wrong[0]!r}"]
                if wrong
                else []
            )
    short = sum(part.short for part in parts)
    long = sum(part.long for part in parts)
    lost = [f"{long} rows have more than {len(header)} cells and are left out"] if long else []
    lost += (
        [f"{short} rows have fewer than {len(header)} cells; missing cells are empty"]
        if short
        else []
    )
    return FileTable(
        numbers, texts, sum(len(part.cells[0]) for part in parts), tuple(lost), tuple(odd)
    )


def _type_column(column: Sequence[Array]) -> tuple[Array, list[str]]:
    """A column as numbers, with its cells that are not numbers; as texts if most are texts."""
    if all(part.dtype != object for part in column):
        values = np.concatenate(column)
        wrong = [str(value) for value in values[np.isinf(values)].tolist()]
        return np.where(np.isfinite(values), values, np.nan), wrong
    cells = np.concatenate([part.astype(object) for part in column])
    numbers = np.array([cell_number(cell) for cell in cells.tolist()])
    filled = np.array([c == c and cell_text(c).lower() not in EMPTY for c in cells.tolist()])
    sound = np.isfinite(numbers)
    if sound.sum() <= _MISTYPED * filled.sum():
        return np.array([cell_text(cell) for cell in cells.tolist()], dtype=object), []
    return np.where(sound, numbers, np.nan), [
        cell_text(cell) for cell in cells[filled & ~sound].tolist()
    ]


def _read_yaml_table(path: Path, limits: Input) -> FileTable:
    most = int(limits.max_yaml_mb * yaml_text.MOST_VALUES)
    rows = yaml_text.parse_yaml_text(path.read_text(encoding="utf-8-sig"), most)
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise ValueError(
            "it must be a list of mappings, one for each pose: - {pan: 0.1, tip_u: 310.5, "
            "tip_v: 99}"
        )
    flat = [dict(_flatten_row(row)) for row in rows]
    names = column_names(list(dict.fromkeys(name for row in flat for name in row)), path)
    TableSize(limits).take(
        OBJECT_BYTES * len(names) * len(flat), f"{path}: {len(flat)} rows of {len(names)} columns"
    )
    return _of_cells(
        names, [cell_objects([row.get(name) for row in flat]) for name in names], len(rows), path
    )


def _flatten_row(
    row: Mapping[Any, Any], before: str = "", depth: int = 0
) -> Iterator[tuple[str, Any]]:
    """The cells of one mapping, inner ones under the outer's:
    `tip: {u: 3, v: 4}` or `tip: [3, 4]` is tip_u, tip_v.
    """
    for key, value in row.items():
        name = f"{before}{key}"
        if isinstance(value, dict) and depth < 4:
            inner = "" if name in ("joints", "position", "positions") else f"{name}_"
            yield from _flatten_row(value, inner, depth + 1)
        elif (
            isinstance(value, list)
            and len(value) == 2
            and all(isinstance(v, int | float) for v in value)
        ):
            yield from zip((f"{name}_u", f"{name}_v"), value, strict=True)
        else:
            yield name, value


def _of_cells(names: Sequence[str], cells: Sequence[Array], rows: int, path: Path) -> FileTable:
    found = _join_table_pieces(names, iter([_TablePiece(cells, 0, 0)]), path)
    return FileTable(found.numbers, found.texts, rows, found.lost, found.odd)


def _read_parquet_columns(path: Path, limits: Input) -> FileTable:
    names, cells, rows = read_parquet_table(path, limits)
    return _of_cells(names, cells, rows, path)


READERS: Mapping[str, Callable[[Path, Input], FileTable]] = {
    "csv": _read_csv,
    "parquet": _read_parquet_columns,
    "yaml": _read_yaml_table,
}


def read_parquet_table(path: Path, limits: Input) -> tuple[list[str], list[Array], int]:
    """Names and cells (N,) of the columns, and the number
    of rows; FormatError or LogError where it is unreadable.
    """
    parquet = require_module("pyarrow.parquet", path)
    with _arrow_damage_errors(path):
        return _of_file(path, limits, parquet)


@contextmanager
def _arrow_damage_errors(path: Path) -> Iterator[None]:
    """Turn what Arrow raises for a damaged file, or for
    types that it does not convert, into a FormatError.
    """
    arrow: Any = import_module("pyarrow")
    try:
        yield
    except (arrow.ArrowException, OSError, KeyError, OverflowError) as problem:
        if getattr(problem, "filename", None) is not None:  # the file could not be opened
            raise
        raise FormatError(f"{path}: not a parquet table: {exception_line(problem)}") from None


def _of_file(path: Path, limits: Input, parquet: Any) -> tuple[list[str], list[Array], int]:
    with parquet.ParquetFile(path) as file:
        names = column_names(list(file.schema_arrow.names), path)
        leaves = parquet_pages.list_parquet_leaves(path, file, limits)
        texts = [name for name in names if _is_text(file.schema_arrow.field(name).type)]
        size = TableSize(limits)
        for name in names:
            _charge_table_column(
                path, name, list(parquet_pages.leaves_under_column(leaves, name)), file, size
            )
        rows = file.metadata.num_rows
    with parquet.ParquetFile(path, read_dictionary=texts) as file:
        # one copy of each text, however often it occurs
        table = file.read()
    columns = [(name, table.column(place)) for place, name in enumerate(names)]
    flat = [
        pair for name, column in columns for pair in _arrow_column_values(path, name, column, size)
    ]
    return [name for name, _ in flat], [cells for _, cells in flat], rows


def _charge_table_column(
    path: Path, name: str, leaves: Sequence[parquet_pages.ParquetLeaf], file: Any, size: TableSize
) -> None:
    """Count a column before it is read; the texts of a
    plain column are counted once it is known which occur.
    """
    kind = file.schema_arrow.field(name).type
    values = sum(leaf.values for leaf in leaves)
    if _is_plain(kind):
        size.take(8 * values, f"{path}: {name}")
    elif _is_text(kind):
        size.take(8 * values + sum(leaf.texts_read for leaf in leaves), f"{path}: {name}")
    else:
        texts = sum(leaf.texts_copied - leaf.page_bytes for leaf in leaves)
        size.take(OBJECT_BYTES * values + texts, f"{path}: {name}")


def _is_plain(kind: Any) -> bool:
    types: Any = import_module("pyarrow.types")
    return bool(types.is_floating(kind) or types.is_integer(kind) or types.is_boolean(kind))


def _is_text(kind: Any) -> bool:
    types: Any = import_module("pyarrow.types")
    return bool(types.is_string(kind) or types.is_binary(kind))


def _arrow_column_values(
    path: Path, name: str, column: Any, size: TableSize
) -> Iterator[tuple[str, Array]]:
    """A Parquet column as a table column; a list of fixed length as several: name.0, name.1, ..."""
    if _is_plain(column.type):
        yield name, column.cast("float64").to_numpy()
        return
    types: Any = import_module("pyarrow.types")
    if types.is_dictionary(column.type):
        size.take(_text_bytes(column), f"{path}: {name}")
    cells = column.to_pylist()
    widths = {len(cell) for cell in cells if isinstance(cell, list)}
    if len(widths) == 1 and all(isinstance(cell, list) for cell in cells):
        yield from (
            (f"{name}.{k}", cell_objects([cell[k] for cell in cells])) for k in range(min(widths))
        )
    else:
        yield name, cell_objects(cells)


def _text_bytes(column: Any) -> int:
    """What the texts of a dictionary column take as Python objects."""
    compute: Any = import_module("pyarrow.compute")
    whole = OBJECT_BYTES * len(column)
    for chunk in column.chunks:
        lengths = compute.take(compute.binary_length(chunk.dictionary), chunk.indices)
        whole += int(compute.sum(lengths).as_py() or 0)
    return int(whole)


def column_names(names: list[str], path: Path) -> list[str]:
    """The names of the columns; FormatError when they are missing or not unique."""
    if not any(names):
        raise FormatError(f"{path}: the table has no header; name its columns in the first line")
    if all(is_number(name) for name in names if name):
        raise FormatError(
            f"{path}: the first line holds numbers ({', '.join(names[:3])}); it must name "
            "the columns"
        )
    if len(names) > _MOST_COLUMNS:
        raise FormatError(f"{path}: {len(names)} columns; at most {_MOST_COLUMNS} are read")
    if twice := next(
        (name for name, count in Counter(filter(None, names)).items() if count > 1), None
    ):
        raise FormatError(
            f"{path}: column {twice!r} occurs {names.count(twice)} times; give each a unique name"
        )
    return names


def cell_text(cell: Any) -> str:
    """A cell as text; an empty one, however its block stores it, is the empty text."""
    return "" if isinstance(cell, float) and cell != cell else str(cell)


def cell_number(cell: Any) -> float:
    """A cell as a number; NaN for a text."""
    try:
        return float(cell)
    except (ValueError, TypeError, OverflowError):
        return float("nan")


def is_number(cell: str) -> bool:
    """Whether a cell is a finite or infinite number."""
    return cell.lower() not in EMPTY and cell_number(cell) == cell_number(cell)


def cell_objects(cells: Sequence[Any]) -> Array:
    """Cells (n,) as a CSV column would hold them."""
    plain = [np.nan if cell is None else cell for cell in cells]
    if all(isinstance(cell, int | float) for cell in plain):
        return np.array([cell_number(cell) for cell in plain])
    out = np.empty(len(plain), dtype=object)
    out[:] = [cell if isinstance(cell, float) else str(cell) for cell in plain]
    return out


def exception_line(problem: Exception) -> str:
    """An exception's text as one line."""
    return " ".join(str(problem).split())[:200]

"""Read columns of Parquet files as arrays; declared sizes are checked before memory is allocated."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError, LogError
from ..records import Array
from .extra import require_module

MOST_VALUES = 1 << 26
"""The most numbers of one column that are read."""
_MOST_ROWS = 1 << 24
_MOST_BYTES = 256 << 20
"""The most bytes that one piece of a column of images may expand to."""


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a Parquet file; LogError if it is not one, FormatError if it is damaged."""
    arrow, parquet = require_module("pyarrow", path), require_module("pyarrow.parquet", path)
    if not path.is_file():
        raise LogError(f"{path}: there is no such file; is the dataset downloaded completely?")
    try:
        with parquet.ParquetFile(path, memory_map=True) as file:
            if file.metadata.num_rows > _MOST_ROWS:
                raise LogError(f"{path}: {file.metadata.num_rows} rows; at most {_MOST_ROWS} are read")
            yield file
    except (arrow.ArrowException, OSError, ValueError, KeyError, OverflowError) as problem:
        raise FormatError(f"{path}: the table cannot be read: {' '.join(str(problem).split())[:160]}") from None


def rows(path: Path, column: str, value: int) -> list[tuple[int, int]]:
    """The rows where an integer column has a value: runs (first, beyond the last), in file order."""
    with opened(path) as file:
        if column not in file.schema_arrow.names:
            return [(0, file.metadata.num_rows)]
        is_it = _numbers(_column(file, column, None, path)).reshape(-1) == value
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_it, [False]]).astype(np.int8)))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]


def columns(path: Path, names: Sequence[str], where: Sequence[tuple[int, int]]) -> dict[str, Array | None]:
    """Columns of numbers (n,K) float64, NaN where empty, in runs of rows; None for other columns.

    A column of variable-length lists is as wide as its longest, padded with NaN.
    """
    with opened(path) as file:
        return {name: _found(file, name, where, path) for name in names if name in file.schema_arrow.names}


def integers(path: Path, name: str, where: Sequence[tuple[int, int]]) -> Array | None:
    """A column of whole numbers (n,) int64 in runs of rows, without rounding; None for other columns."""
    with opened(path) as file:
        types = require_module("pyarrow", path).types
        if name not in file.schema_arrow.names or not types.is_integer(file.schema_arrow.field(name).type):
            return None
        pieces = [_column(file, name, run, path) for run in where]
        if any(piece.null_count for piece in pieces):
            return None
        return np.concatenate([np.empty(0, np.int64), *(piece.to_numpy() for piece in pieces)]).astype(np.int64)


def objects(path: Path, names: Sequence[str]) -> Mapping[str, list[Any]]:
    """Whole columns of a small table as Python values."""
    with opened(path) as file:
        kept = [name for name in names if name in file.schema_arrow.names]
        return {name: _column(file, name, None, path).to_pylist() for name in kept}


def encoded(path: Path, column: str, where: Sequence[tuple[int, int]]) -> Iterator[bytes | None]:
    """Encoded images of a column of {bytes, path}, or of bytes, row by row; None for a missing image."""
    with opened(path) as file:
        first = 0
        for group in range(file.num_row_groups):
            end = first + file.metadata.row_group(group).num_rows
            some = [(max(a, first) - first, min(b, end) - first) for a, b in where if a < end and b > first]
            if some:
                yield from _images(file, group, column, some, path)
            first = end


def _images(file: Any, group: int, column: str, where: Sequence[tuple[int, int]], path: Path) -> Iterator[bytes | None]:
    about = file.metadata.row_group(group)
    if about.num_rows and about.total_byte_size / about.num_rows > _MOST_BYTES:
        raise LogError(f"{path}: {column}: images of {about.total_byte_size // about.num_rows} bytes")
    at = 0
    for piece in file.iter_batches(batch_size=16, row_groups=[group], columns=[column]):
        for cell in piece.column(column).to_pylist():
            if any(a <= at < b for a, b in where):
                data = cell.get("bytes") if isinstance(cell, dict) else cell
                yield data if isinstance(data, bytes) and data else None
            at += 1


def _found(file: Any, name: str, where: Sequence[tuple[int, int]], path: Path) -> Array | None:
    pieces = [_numbers(_column(file, name, run, path)) for run in where]
    if any(piece.dtype == object for piece in pieces):
        return None
    width = max((piece.shape[1] for piece in pieces), default=0)
    return np.concatenate([np.empty((0, width)), *(_padded(piece, width) for piece in pieces)])


def _column(file: Any, name: str, run: tuple[int, int] | None, path: Path) -> Any:
    """One column of a run of rows, or of all; LogError if it declares too many values."""
    arrow = require_module("pyarrow", path)
    pieces, first = [], 0
    for group in range(file.num_row_groups):
        about = file.metadata.row_group(group)
        end = first + about.num_rows
        if run is None or (run[0] < end and run[1] > first):
            own = [about.column(k) for k in range(about.num_columns)]
            most = max((c.num_values for c in own if f"{c.path_in_schema}.".startswith(f"{name}.")), default=0)
            if most > MOST_VALUES:
                raise LogError(f"{path}: {name}: {most} values; at most {MOST_VALUES} are read")
            column = file.read_row_group(group, columns=[name]).column(name)
            low, high = (0, about.num_rows) if run is None else (max(run[0] - first, 0), min(run[1], end) - first)
            pieces += column.slice(low, high - low).chunks
        first = end
    kind = file.schema_arrow.field(name).type
    return arrow.chunked_array(pieces, type=kind).combine_chunks()


def _numbers(column: Any) -> Array:
    """An Arrow column as (n,K) float64, or objects if it holds no numbers; nested lists are flattened."""
    import pyarrow as arrow
    from pyarrow import compute

    if isinstance(column, arrow.ChunkedArray):
        column = column.combine_chunks()
    count, lengths = len(column), np.ones(len(column), np.int64)
    column = getattr(column, "storage", column)
    while _is_list(column.type):
        widths = np.asarray(compute.list_value_length(column).fill_null(0).to_numpy(zero_copy_only=False), np.int64)
        starts = np.concatenate([[0], np.cumsum(lengths)])
        lengths = np.add.reduceat(np.append(widths, 0), starts[:-1]) * (lengths > 0) if count else lengths
        column = column.flatten()
        column = getattr(column, "storage", column)
    types = arrow.types
    if not (types.is_floating(column.type) or types.is_integer(column.type) or types.is_boolean(column.type)):
        return np.empty((count, 0), object)
    flat = column.cast(arrow.float64(), safe=False).to_numpy(zero_copy_only=False)
    width = int(lengths.max(initial=0))
    if (lengths == width).all():
        return np.asarray(flat, float).reshape(count, width)
    out = np.full((count, width), np.nan)
    out[np.arange(width) < lengths[:, None]] = flat
    return out


def _is_list(kind: Any) -> bool:
    import pyarrow as arrow

    types = arrow.types
    return bool(types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind))


def _padded(values: Array, width: int) -> Array:
    return np.hstack([values, np.full((len(values), width - values.shape[1]), np.nan)])

"""Read columns of Parquet files as arrays; declared sizes are checked before memory is taken."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError, LogError
from ...io.extras import require_module
from ..limits import LIMITS, Input, TableSize
from ..records import Array
from ..storage.compression import Allowance
from ..tables import parquet_pages

_MOST_ROWS = 1 << 24
_ROWS_AT_ONCE = 16
"""Images that are read at once, unless so many could be too large."""
_DEEPEST = 16
"""Lists in one another."""
OBJECT_BYTES = 64
"""What a value takes as a Python object, beside its text."""


@contextmanager
def open_parquet(path: Path) -> Iterator[Any]:
    """Open a Parquet file; LogError if it is not one, FormatError if it is damaged."""
    arrow = require_module("pyarrow", path)
    parquet = require_module("pyarrow.parquet", path)
    if not path.is_file():
        raise LogError(f"{path}: there is no such file; is the dataset downloaded completely?")
    try:
        with parquet.ParquetFile(path, memory_map=True) as file:
            if file.metadata.num_rows > _MOST_ROWS:
                raise LogError(
                    f"{path}: {file.metadata.num_rows} rows; at most {_MOST_ROWS} are read"
                )
            yield file
    except (arrow.ArrowException, OSError, ValueError, KeyError, OverflowError) as problem:
        raise FormatError(
            f"{path}: the table cannot be read: {' '.join(str(problem).split())[:160]}"
        ) from None


def list_column_types(path: Path) -> dict[str, str]:
    """The columns of a file, each with the Arrow type of its values: of lists that of their items.

    LogError or FormatError as of `open_parquet`.
    """
    with open_parquet(path) as file:
        return {field.name: str(_innermost_type(field.type)) for field in file.schema_arrow}


def find_row_runs(
    path: Path, column: str, value: int, limits: Input = LIMITS
) -> list[tuple[int, int]]:
    """Rows where an integer column has a value: runs (first, beyond the last), in file order."""
    with open_parquet(path) as file:
        if column not in file.schema_arrow.names:
            return [(0, file.metadata.num_rows)]
        size = TableSize(limits)
        is_it = (
            _arrow_to_floats(
                _read_column_run(file, column, None, path, limits, size), column, size
            ).reshape(-1)
            == value
        )
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_it, [False]]).astype(np.int8)))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]


def read_number_columns(
    path: Path, names: Sequence[str], where: Sequence[tuple[int, int]], limits: Input = LIMITS
) -> dict[str, Array | None]:
    """Columns of numbers (n,K) float64, NaN where empty, in runs of rows; None for other columns.

    A column of variable-length lists is as wide as its
    longest, padded with NaN. LogError where all are too large.
    """
    size = TableSize(limits)
    with open_parquet(path) as file:
        there = [name for name in names if name in file.schema_arrow.names]
        return {name: _read_runs(file, name, where, path, limits, size) for name in there}


def read_integer_column(
    path: Path, name: str, where: Sequence[tuple[int, int]], limits: Input = LIMITS
) -> Array | None:
    """A column of whole numbers (n,) int64 in runs of
    rows, without rounding; None for other columns.
    """
    with open_parquet(path) as file:
        types = require_module("pyarrow", path).types
        if name not in file.schema_arrow.names or not types.is_integer(
            file.schema_arrow.field(name).type
        ):
            return None
        size = TableSize(limits)
        pieces = [_read_column_run(file, name, run, path, limits, size) for run in where]
        if any(piece.null_count for piece in pieces):
            return None
        return np.concatenate(
            [np.empty(0, np.int64), *(piece.to_numpy() for piece in pieces)]
        ).astype(np.int64)


def read_object_columns(
    path: Path, names: Sequence[str], limits: Input = LIMITS
) -> Mapping[str, list[Any]]:
    """Whole columns of a small table as Python values."""
    size = TableSize(limits)
    with open_parquet(path) as file:
        kept = [name for name in names if name in file.schema_arrow.names]
        return {
            name: _read_column_run(file, name, None, path, limits, size, OBJECT_BYTES).to_pylist()
            for name in kept
        }


def read_encoded_images(
    path: Path, column: str, where: Sequence[tuple[int, int]], limits: Input = LIMITS
) -> Iterator[bytes | None]:
    """Encoded images of a column of {bytes, path}, or
    of bytes, row by row; None for a missing image.

    LogError where they are more than a file may unpack to.
    """
    allowance = Allowance(path, limits)
    packed = path.stat().st_size
    unpacked = 0
    with open_parquet(path) as file:
        first = 0
        for group in range(file.num_row_groups):
            end = first + file.metadata.row_group(group).num_rows
            some = [
                (max(a, first) - first, min(b, end) - first)
                for a, b in where
                if a < end and b > first
            ]
            for data in (
                _images_of_row_group(file, group, column, some, path, limits) if some else ()
            ):
                unpacked += len(data or b"")
                allowance.check(packed, unpacked)
                yield data
            first = end


def _images_of_row_group(
    file: Any, group: int, column: str, where: Sequence[tuple[int, int]], path: Path, limits: Input
) -> Iterator[bytes | None]:
    leaves = parquet_pages.list_parquet_leaves(path, file, limits, (group,))
    largest = max(
        (leaf.largest for leaf in parquet_pages.leaves_under_column(leaves, column)), default=0
    )
    at_once = max(1, min(_ROWS_AT_ONCE, int(limits.max_message_mb * 1e6) // max(largest, 1)))
    at = 0
    for piece in file.iter_batches(batch_size=at_once, row_groups=[group], columns=[column]):
        for cell in piece.column(column):
            if any(a <= at < b for a, b in where):
                cell = cell.as_py()
                data = cell.get("bytes") if isinstance(cell, dict) else cell
                yield data if isinstance(data, bytes) and data else None
            at += 1


def _read_runs(
    file: Any,
    name: str,
    where: Sequence[tuple[int, int]],
    path: Path,
    limits: Input,
    size: TableSize,
) -> Array | None:
    if not _holds_numbers(file.schema_arrow.field(name).type):
        return None
    pieces = [
        _arrow_to_floats(_read_column_run(file, name, run, path, limits, size), name, size)
        for run in where
    ]
    width = max((piece.shape[1] for piece in pieces), default=0)
    if any(piece.shape[1] != width for piece in pieces):
        size.take(
            8 * width * sum(map(len, pieces)), f"{path}: {name}, each row as wide as the widest"
        )
    return np.concatenate(
        [np.empty((0, width)), *(_pad_columns_with_nan(piece, width) for piece in pieces)]
    )


def _read_column_run(
    file: Any,
    name: str,
    run: tuple[int, int] | None,
    path: Path,
    limits: Input,
    size: TableSize,
    bytes_each: int = 8,
) -> Any:
    """One column of a run of rows, or of all; LogError if its pages hold more than may be read."""
    arrow = require_module("pyarrow", path)
    pieces = []
    first = 0
    for group in range(file.num_row_groups):
        end = first + file.metadata.row_group(group).num_rows
        if run is None or (run[0] < end and run[1] > first):
            _charge_column_size(file, name, group, path, limits, size, bytes_each)
            column = file.read_row_group(group, columns=[name]).column(name)
            low, high = (
                (0, end - first)
                if run is None
                else (max(run[0] - first, 0), min(run[1], end) - first)
            )
            pieces += column.slice(low, high - low).chunks
        first = end
    kind = file.schema_arrow.field(name).type
    return arrow.chunked_array(pieces, type=kind).combine_chunks()


def _charge_column_size(
    file: Any, name: str, group: int, path: Path, limits: Input, size: TableSize, bytes_each: int
) -> None:
    """Count what a column of a row group takes: its
    values, and the texts of one that holds no numbers.
    """
    found = list(
        parquet_pages.leaves_under_column(
            parquet_pages.list_parquet_leaves(path, file, limits, (group,)), name
        )
    )
    whole = bytes_each * sum(leaf.values for leaf in found)
    if not _holds_numbers(file.schema_arrow.field(name).type):
        whole += sum(leaf.texts_copied for leaf in found)
    size.take(whole, f"{path}: {name}")


def _arrow_to_floats(column: Any, name: str, size: TableSize) -> Array:
    """An Arrow column of numbers as (n,K) float64; nested
    lists are flattened, and shorter ones end in NaN.
    """
    import pyarrow as arrow
    from pyarrow import compute

    if isinstance(column, arrow.ChunkedArray):
        column = column.combine_chunks()
    count = len(column)
    lengths = np.ones(len(column), np.int64)
    column = getattr(column, "storage", column)
    while _is_list(column.type):
        widths = np.asarray(
            compute.list_value_length(column).fill_null(0).to_numpy(zero_copy_only=False), np.int64
        )
        starts = np.concatenate([[0], np.cumsum(lengths)])
        lengths = (
            np.add.reduceat(np.append(widths, 0), starts[:-1]) * (lengths > 0) if count else lengths
        )
        column = column.flatten()
        column = getattr(column, "storage", column)
    flat = column.cast(arrow.float64(), safe=False).to_numpy(zero_copy_only=False)
    width = int(lengths.max(initial=0))
    if (lengths == width).all():
        return np.asarray(flat, float).reshape(count, width)
    size.take(8 * width * count, f"{name}: {count} rows, each as wide as the widest of {width}")
    out = np.full((count, width), np.nan)
    out[np.arange(width) < lengths[:, None]] = flat
    return out


def _holds_numbers(kind: Any) -> bool:
    """Whether an Arrow type is of numbers, or of lists of them."""
    import pyarrow as arrow

    types = arrow.types
    kind = _innermost_type(kind)
    return bool(types.is_floating(kind) or types.is_integer(kind) or types.is_boolean(kind))


def _innermost_type(kind: Any) -> Any:
    """The Arrow type of a list's items, through lists in one another; a list beyond _DEEPEST."""
    for _ in range(_DEEPEST):
        kind = getattr(kind, "storage_type", kind)
        if not _is_list(kind):
            return kind
        kind = kind.value_type
    return kind


def _is_list(kind: Any) -> bool:
    import pyarrow as arrow

    types = arrow.types
    return bool(types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind))


def _pad_columns_with_nan(values: Array, width: int) -> Array:
    return np.hstack([values, np.full((len(values), width - values.shape[1]), np.nan)])

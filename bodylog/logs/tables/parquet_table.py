"""A Parquet file as cells by column; what its pages hold is counted before they are read."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from ...errors import FormatError
from ...io.extras import require_module
from ..limits import Input, TableSize
from ..records import Array
from . import parquet_pages
from .cells import OBJECT_BYTES, cell_objects, column_names, exception_line


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

"""A recording's signals as tables: one CSV or Parquet file per role."""

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path

from ..errors import UsageError
from ..files import replacing
from ..types import Array, Recording, Series
from .ingest import ALWAYS, Window, cut, signals

FORMATS = ("csv", "parquet")
_ROWS = 65536


def export(recording: Recording, folder: Path, form: str, window: Window = ALWAYS) -> tuple[Path, ...]:
    """Write joints, truth and skin to folder/<role>.<form>, a row per message: stamp_ns, t (s), one column per name.

    UsageError for an unknown form, or when Parquet is asked for and pyarrow is not installed.
    """
    if form not in FORMATS:
        raise UsageError(f"export as {form!r}: possible are {', '.join(FORMATS)}")
    save = _csv if form == "csv" else _parquet()
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for role, series in signals(recording).items():
        paths.append(folder / f"{role}.{form}")
        with replacing(paths[-1]) as beside:
            save(_table(cut(series, recording.start_ns, window)), beside)
    return tuple(paths)


def _table(series: Series) -> dict[str, Array]:
    names = [name if name not in ("stamp_ns", "t") else f"{name}_" for name in series.names]
    columns = dict(zip(names, series.values.T, strict=True))
    return {"stamp_ns": series.source_ns, "t": series.t, **columns}


def _csv(table: Mapping[str, Array], path: Path) -> None:
    """Numbers as short as they read back exactly; NaN stays empty."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(",".join(_quoted(name) for name in table) + "\n")
        for first in range(0, len(table["t"]), _ROWS):
            texts = [_texts(column[first : first + _ROWS]) for column in table.values()]
            stream.writelines(",".join(row) + "\n" for row in zip(*texts, strict=True))


def _texts(column: Array) -> list[str]:
    return ["" if value != value else repr(value) for value in column.tolist()]


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if set(name) & set(',"\n\r') else name


def _parquet() -> Callable[[Mapping[str, Array], Path], None]:
    try:
        pyarrow, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError:
        raise UsageError('Parquet needs pyarrow; type: pip install "bodylog[parquet]", or use --csv') from None
    return lambda table, path: parquet.write_table(pyarrow.table(dict(table)), path)

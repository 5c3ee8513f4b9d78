"""Export a recording's signals as tables, one CSV or
Parquet file per role; and its features as CSV files.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from urllib.parse import quote

import numpy as np

from ..errors import UsageError
from ..io.atomic_files import ensure_dir, replace_atomically
from ..io.extras import require_module
from ..types import MM_PER_M, Array, Features, Recording, Series
from .tidy import ALWAYS, Window, cut_to_window, signals_by_role

FORMATS = ("csv", "parquet")
_ROWS = 65536


def choose_table_writer(form: str) -> Callable[[Mapping[str, Array], Path], None]:
    """A function that writes a table in that format; UsageError
    for an unknown one, or for Parquet without pyarrow.
    """
    if form not in FORMATS:
        raise UsageError(f"export as {form!r}: possible are {', '.join(FORMATS)}")
    return _write_csv_table if form == "csv" else _make_parquet_writer()


def export_signals(
    recording: Recording, folder: Path, form: str, window: Window = ALWAYS
) -> tuple[Path, ...]:
    """Write joints, truth and skin to folder/<role>.<form>,
    a row per message: stamp_ns, t (s), one column per name.

    UsageError for an unknown format, or for Parquet without pyarrow.
    """
    save = choose_table_writer(form)
    ensure_dir(folder)
    paths = []
    for role, series in signals_by_role(recording).items():
        paths.append(folder / f"{role}.{form}")
        with replace_atomically(paths[-1]) as beside:
            save(_series_columns(cut_to_window(series, recording.start_ns, window)), beside)
    return tuple(paths)


def export_features(features: Features, folder: Path) -> tuple[Path, ...]:
    """Write tracks_<name>.csv, strokes.csv and, with
    a skin, touches.csv and synchrony.csv to folder.

    Times in s since the log's start, positions in px, points in space in m; unseen ones are empty. Characters not allowed
    in file names become %XX.
    """
    tables = {
        f"tracks_{quote(name, safe='')}": _track_columns(track)
        for name, track in features.tracks.items()
    }
    tables["strokes"] = _columns_of_rows(
        ("start", "end", "start_u", "start_v", "end_u", "end_v"),
        [
            (stroke.start, stroke.end, *stroke.start_px, *stroke.end_px)
            for stroke in features.strokes
        ],
    )
    if (touches := features.touches) is not None:
        tables["touches"] = _columns_of_rows(
            ("onset", "offset", "peak", "strongest", "cells"),
            [
                (one.onset, one.offset, one.peak, one.strongest, " ".join(map(str, one.cells)))
                for one in touches
            ],
        )
        pairs = features.synchrony
        tables["synchrony"] = _columns_of_rows(
            ("touch", "stroke", "delay", "weight"),
            [
                (pair.touch, "" if pair.stroke is None else pair.stroke, pair.delay, pair.weight)
                for pair in pairs
            ],
        )
    ensure_dir(folder)
    paths = []
    for name, table in tables.items():
        paths.append(folder / f"{name}.csv")
        with replace_atomically(paths[-1]) as beside:
            _write_csv_table(table, beside)
    return tuple(paths)


def _track_columns(track: Series) -> dict[str, Array]:
    std = np.full(track.values.shape, np.nan) if track.std is None else track.std
    size = 1.0 / MM_PER_M if track.unit == "mm" else 1.0
    columns = np.column_stack([track.t, size * track.values, size * std]).T
    names = ("t", *track.names, *(f"std_{axis}" for axis in track.names))
    return dict(zip(names, columns, strict=True))


def _columns_of_rows(names: Sequence[str], rows: Sequence[Sequence[object]]) -> dict[str, Array]:
    """Rows as columns, with unchanged values."""
    table = np.empty((len(rows), len(names)), dtype=object)
    for index, row in enumerate(rows):
        table[index] = row
    return dict(zip(names, table.T, strict=True))


def _series_columns(series: Series) -> dict[str, Array]:
    names = [name if name not in ("stamp_ns", "t") else f"{name}_" for name in series.names]
    columns = dict(zip(names, series.values.T, strict=True))
    return {"stamp_ns": series.source_ns, "t": series.t, **columns}


def _write_csv_table(table: Mapping[str, Array], path: Path) -> None:
    """The shortest decimal numbers that read back exactly; NaN is empty."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(",".join(_quote_csv_name(name) for name in table) + "\n")
        for first in range(0, len(next(iter(table.values()))), _ROWS):
            texts = [_texts_of_column(column[first : first + _ROWS]) for column in table.values()]
            stream.writelines(",".join(row) + "\n" for row in zip(*texts, strict=True))


def _texts_of_column(column: Array) -> list[str]:
    return ["" if value != value else str(value) for value in column.tolist()]


def _quote_csv_name(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if set(name) & set(',"\n\r') else name


def _make_parquet_writer() -> Callable[[Mapping[str, Array], Path], None]:
    pyarrow = require_module("pyarrow")
    parquet = require_module("pyarrow.parquet")

    def save(table: Mapping[str, Array], path: Path) -> None:
        with path.open("wb") as stream:
            parquet.write_table(pyarrow.table(dict(table)), stream)

    return save

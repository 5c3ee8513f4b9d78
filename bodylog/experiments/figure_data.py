"""The numbers behind figures and verdicts as tables,
CSV and (where pyarrow is installed) Parquet.
"""

import csv
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ..io import atomic_files
from ..recording.tables import choose_table_writer
from ..types import Array
from .claims import Claim
from .records import Trial

Columns = Mapping[str, Array]


def write_figure_data(
    out: Path, trials: Mapping[str, Sequence[Trial]], claims: Sequence[Claim]
) -> None:
    """Write data/NAME.csv and .parquet: each experiment's
    figures over time, every seed's figures, every outcome.
    """
    folder = out / "data"
    folder.mkdir(exist_ok=True)
    tables = {
        name: tabulate_series(found[0]["panels"])
        for name, found in trials.items()
        if found[0]["panels"]
    }
    tables["figures"] = tabulate_figures(trials)
    tables["outcomes"] = tabulate_outcomes(claims)
    for form in ("csv", "parquet") if find_spec("pyarrow") else ("csv",):
        save = _write_csv if form == "csv" else choose_table_writer(form)
        for name, table in tables.items():
            save(table, folder / f"{name}.{form}")


def _write_csv(table: Columns, path: Path) -> None:
    """Text is quoted where necessary; NaN is an empty cell."""
    columns = [["" if v != v else v for v in column.tolist()] for column in table.values()]
    with (
        atomic_files.replace_atomically(path) as beside,
        beside.open("w", encoding="utf-8", newline="") as stream,
    ):
        rows = csv.writer(stream, lineterminator="\n")
        rows.writerow(table)
        rows.writerows(zip(*columns, strict=True))


def tabulate_series(panels: Sequence[Mapping[str, Any]]) -> Columns:
    """The first seed's panels: the paper's figure, panel,
    line, axis, at, unit, value; a row for each point.
    """
    rows = [
        (
            one["figure"],
            one["title"],
            line,
            one["axis"],
            at,
            one["unit"],
            np.nan if value is None else value,
        )
        for one in panels
        for line, values in one["lines"].items()
        for at, value in zip(one["t"], values, strict=True)
    ]
    return _rows_to_columns(
        ("figure", "panel", "line", "axis", "at", "unit", "value"), rows, (4, 6)
    )


def tabulate_figures(trials: Mapping[str, Sequence[Trial]]) -> Columns:
    """Every figure of every seed: experiment, reading (""
    where the paper's model is not run), figure, seed, value.
    """
    rows = []
    for name, found in trials.items():
        for seed, trial in enumerate(found):
            for key, value in trial["figures"].items():
                reading, _, figure = key.rpartition(" | ")
                rows.append(
                    (name, reading, figure, float(seed), np.nan if value is None else float(value))
                )
    return _rows_to_columns(("experiment", "reading", "figure", "seed", "value"), rows, (3, 4))


def tabulate_outcomes(claims: Sequence[Claim]) -> Columns:
    """Every claim's outcome in every reading and at
    every number swept, with the bound and the interval.
    """
    rows = []
    for claim in claims:
        found = [(key, "", np.nan, one) for key, one in claim.outcomes.items()]
        found += [
            ("", name, number, one) for name, swept in claim.sweeps.items() for number, one in swept
        ]
        for reading, constant, number, one in found:
            rows.append(
                (
                    claim.id,
                    claim.kind,
                    reading,
                    constant,
                    number,
                    claim.bound,
                    one.median,
                    *one.interval,
                    one.tested_seeds,
                    one.kept_seeds,
                    one.state,
                    one.reason,
                )
            )
    places = ("claim", "kind", "reading", "swept", "number", "bound")
    head = (*places, "median", "low", "high", "tested_seeds", "kept_seeds", "state", "reason")
    return _rows_to_columns(head, rows, (4, 6, 7, 8, 9, 10))


def _rows_to_columns(
    head: Sequence[str], rows: Sequence[Sequence[Any]], numbers: Sequence[int]
) -> Columns:
    parts = list(zip(*rows, strict=True)) or [()] * len(head)
    return {
        name: np.array(part, float if k in numbers else str)
        for k, (name, part) in enumerate(zip(head, parts, strict=True))
    }

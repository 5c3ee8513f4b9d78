"""What a dataset's examination leaves: evidence read back, the dataset's row, the page, and the
table of episodes."""

from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path

import numpy as np

from ..errors import BoundError
from ..evaluation import bounds as score_bounds
from ..io.atomic_files import read_limited_text as read_text
from ..io.atomic_files import replace_atomically
from ..io.values import read_json
from ..types import Array, Fault
from .files import dataset_findings
from .judgement import DatasetJudgement, Evidence, Row, judge_episodes

EVIDENCE = "evidence.json"
DATASET = "dataset"
"""Name of the row of the whole."""
_MOST_BYTES = 64 << 20


def judge_dataset(out: Path, rows: Sequence[Row], body: Path | None = None) -> DatasetJudgement:
    """Judge the rows in a folder by the evidence beside them, the dataset's own files, and the body
    by which the episodes were examined."""
    evidence = read_evidence(out, rows)
    findings = tuple(
        dict.fromkeys(dataset_findings({row["name"]: row["log"] for row in rows}, evidence))
    )
    return judge_episodes(rows, evidence, findings, _find_lasting_faults(rows, evidence, body))


def _find_lasting_faults(
    rows: Sequence[Row], evidence: Mapping[str, Evidence], body: Path | None
) -> list[tuple[str, Fault]]:
    """What episodes together tell of a change since a body was learned: the first of them, and the
    fault."""
    from ..body import storage
    from ..surface.estimate import find_lasting_faults

    names = [row["name"] for row in rows if row["name"] in evidence]
    if body is None or not any(evidence[name].get("changes") for name in names):
        return []
    found = find_lasting_faults(
        [evidence[name].get("changes", {}) for name in names], storage.load_body(body)
    )
    return [(names[number], fault) for number, fault in found]


def read_evidence(out: Path, rows: Sequence[Row]) -> dict[str, Evidence]:
    """The evidence of the rows that have some, by name; a file that cannot be read counts as
    none."""
    found: dict[str, Evidence] = {}
    for row in rows:
        if EVIDENCE not in row["outputs"]:
            continue
        try:
            known = read_json(read_text(out / row["name"] / EVIDENCE, _MOST_BYTES))
        except (OSError, ValueError):
            continue
        if isinstance(known, dict) and isinstance(known.get("figures"), dict):
            found[row["name"]] = known
    return found


def dataset_row(judged: DatasetJudgement, bounds: Sequence[str]) -> Row:
    """The row of the whole: its verdict, scores with standard errors, outliers; a bound on these
    may be broken."""
    code = 0
    error = None
    known = [score_bounds.parse_bound(text) for text in bounds]
    try:
        score_bounds.check_bounds(
            {DATASET: judged.scores}, score_bounds.select_measured_bounds(judged.scores, known)
        )
    except BoundError as problem:
        code = problem.exit_code
        error = str(problem)
    return {
        "name": DATASET,
        "log": "",
        "status": "bound broken" if code else "passed",
        "exit_code": code,
        "error": error,
        "verdict": list(judged.verdict),
        "scores": {one.name: one.value if isfinite(one.value) else None for one in judged.scores},
        "findings": [["warning", text] for text in judged.findings],
        "outliers": [
            {"episode": one.episode, "figures": list(one.figures), "sigma": one.z, "text": one.text}
            for one in judged.outliers
        ],
    }


def render_dataset_page(judged: DatasetJudgement) -> str:
    """The page about a dataset as text."""
    from ..report.page.dataset_page import dataset_page

    odd = [(one.episode, one.text) for one in judged.outliers]
    return dataset_page(judged.rows, judged.evidence, judged.verdict, odd)


def write_table(rows: Sequence[Row], path: Path) -> None:
    """Write a table with a row per episode: .parquet, or CSV; UsageError for Parquet without
    pyarrow."""
    from ..recording.tables import choose_table_writer

    save = choose_table_writer("parquet" if path.suffix == ".parquet" else "csv")
    with replace_atomically(path) as beside:
        save(table_columns(rows), beside)


def table_columns(rows: Sequence[Row]) -> Mapping[str, Array]:
    """Name, log, status, exit code, every figure of any episode (NaN where it was not measured),
    and the findings."""
    figures = sorted({name for row in rows for name in row["scores"]})
    found: dict[str, Array] = {
        key: np.array([str(row[key]) for row in rows]) for key in ("name", "log", "status")
    }
    found["exit_code"] = np.array([row["exit_code"] for row in rows], np.int64)
    for name in figures:
        values = [row["scores"].get(name) for row in rows]
        found[name] = np.array([np.nan if value is None else value for value in values], float)
    texts = [
        "; ".join(text for severity, text in row["findings"] if severity != "info") for row in rows
    ]
    found["findings"] = np.array(texts)
    return found

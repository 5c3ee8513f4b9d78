"""What a batch leaves: results.jsonl as it goes, then in
name order; junit.xml for CI; summary.html for people.
"""

import html
import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..findings import headline, verdict
from ..io.atomic_files import write_text_atomically
from . import folders, resume
from .jobs import EXAMINE, Job, Row
from .resume import ODD


class Journal:
    """The rows in a batch's folder: appended to results.jsonl
    as they come, so that an interrupted batch shows them.

    Other shards may write there as well. Every row is also
    in its log's folder, and from there all are put together.
    """

    def __init__(
        self, out: Path, whole: Sequence[Job], names: frozenset[str], own: Mapping[str, Row]
    ) -> None:
        """Of the jobs of all shards; of those called `names` the rows are `own`, which grows."""
        self._path = out / "results.jsonl"
        self._out = out
        self._own = own
        self._whole = whole
        self._names = names
        self._seen = (0, 0)
        with folders.lock_folder(out, folders.BATCH):
            self._rewrite()

    def add(self, row: Row) -> None:
        """Append a row, or put all together again where another shard did so meanwhile."""
        with folders.lock_folder(self._out, folders.BATCH):
            if self._is_superseded():
                return
            if not self._path.is_file() or self._state() != self._seen:
                self._rewrite()
                return
            with self._path.open("a", encoding="utf-8", errors=ODD) as stream:
                stream.write(row_as_json_line(row))
            self._seen = self._state()

    def finish(self) -> list[Row]:
        """All three files, whole, in name order; again where another shard ended meanwhile, as
        without locks it can.

        Returns the rows as written.
        """
        rows: list[Row] | None = None
        final: list[Row] = []
        while rows is None or rows != self._rows():
            with folders.lock_folder(self._out, folders.BATCH):
                rows = self._rows()
                if self._is_superseded():
                    return rows
                final = self._write(rows)
        return final

    def _write(self, rows: list[Row]) -> list[Row]:
        """The files of the task, with all rows; returns the rows as written."""
        first = self._whole[0]
        if first.task == EXAMINE:
            return write_examined(self._out, rows, first.bounds, first.body)
        write_batch_files(self._out, rows)
        return rows

    def _is_superseded(self) -> bool:
        """Whether a batch of these and more logs began in the folder since: it writes all rows."""
        return folders.is_claimed_by_more(self._out, {job.name: job.log for job in self._whole})

    def _rows(self) -> list[Row]:
        """This shard's rows, and what others left that was done as this one does it."""
        found = (
            self._own.get(job.name) if job.name in self._names else resume.read_valid_row(job)
            for job in self._whole
        )
        return [row for row in found if row is not None]

    def _rewrite(self) -> None:
        write_text_atomically(self._path, "".join(map(row_as_json_line, self._rows())), ODD)
        self._seen = self._state()

    def _state(self) -> tuple[int, int]:
        """Another file, or another length, once somebody else wrote there."""
        found = self._path.stat()
        return found.st_ino, found.st_size


def row_as_json_line(row: Row) -> str:
    """A row as one line of JSON, keys in order."""
    return json.dumps(row, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"


def write_batch_files(out: Path, rows: Sequence[Row]) -> None:
    """All three files, whole, rows in the order given."""
    texts = {
        "results.jsonl": "".join(map(row_as_json_line, rows)),
        "junit.xml": junit_xml(rows),
        "summary.html": summary_page(rows),
    }
    for name, text in texts.items():
        write_text_atomically(out / name, text, ODD)


def write_examined(
    out: Path, rows: Sequence[Row], bounds: Sequence[str], body: Path | None
) -> list[Row]:
    """The files of a dataset's examination, by a body or by none; returns the rows, judged beside
    their siblings.

    JUnit XML has one more case, for the dataset: bounds may name figures of the whole.
    """
    from ..dataset import outputs

    judged = outputs.judge_dataset(out, rows, body)
    whole = outputs.dataset_row(judged, bounds)
    texts = {
        "results.jsonl": "".join(map(row_as_json_line, judged.rows)),
        "junit.xml": junit_xml([*judged.rows, whole]),
        folders.DATASET: row_as_json_line(whole),
        folders.PAGE: outputs.render_dataset_page(judged),
    }
    for name, text in texts.items():
        write_text_atomically(out / name, text, ODD)
    return judged.rows


def junit_xml(rows: Sequence[Row]) -> str:
    """JUnit XML: a broken bound is a failure; an
    unusable log, a bug or a log not reached is an error.
    """
    failures = sum(row["exit_code"] == 4 for row in rows)
    errors = sum(row["exit_code"] not in (0, 3, 4) for row in rows)
    counts = {"tests": str(len(rows)), "failures": str(failures), "errors": str(errors)}
    suites = ET.Element("testsuites", {"name": "bodylog", **counts})
    suite = ET.SubElement(suites, "testsuite", {"name": "bodylog batch", **counts, "skipped": "0"})
    for row in rows:
        _add_test_case(suite, row)
    ET.indent(suites)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(suites, encoding="unicode") + "\n"
    )


def _add_test_case(suite: ET.Element, row: Row) -> None:
    case = ET.SubElement(
        suite, "testcase", {"classname": "bodylog", "name": _xml_text(row["name"])}
    )
    if row["exit_code"] not in (0, 3):
        kind = "failure" if row["exit_code"] == 4 else "error"
        first = _xml_text(row["error"]).strip().splitlines()[-1]
        ET.SubElement(case, kind, {"message": first, "type": row["status"]}).text = _xml_text(
            row["error"]
        )
    scores = "\n".join(f"{name} = {value}" for name, value in row["scores"].items())
    findings = "\n".join(f"{severity}: {text}" for severity, text in row["findings"])
    ET.SubElement(case, "system-out").text = _xml_text(f"{row['log']}\n{scores}\n{findings}")


def _xml_text(text: str) -> str:
    """Text without the control characters XML 1.0 cannot hold."""
    return "".join(
        c if c in "\t\n" or " " <= c <= "\ud7ff" or "\ue000" <= c <= "\ufffd" else "�" for c in text
    )


def summary_page(rows: Sequence[Row]) -> str:
    """A page with the verdict and one line per log:
    its main figures; everything from a log is escaped.
    """
    names = [name for name in headline.NAMES if any(name in row["headline"] for row in rows)]
    heads = ("log", "status", *names, "remark")
    head = "".join(f"<th>{html.escape(name)}</th>" for name in heads)
    text = "\n".join(
        f"<p>{html.escape(sentence)}</p>" for sentence in verdict.verdict_of_batch(rows)
    )
    body = "\n".join(_summary_row(row, names) for row in rows)
    return PAGE.format(count=len(rows), verdict=text, head=head, body=body)


PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>bodylog batch</title>
<style>
body{{font:14px sans-serif;margin:2em}} td,th{{padding:.2em .8em;text-align:left;border-bottom:1px solid #ddd}}
</style>
<h1>{count} logs</h1>
{verdict}
<table><tr>{head}</tr>
{body}
</table></html>
"""


def _summary_row(row: Row, names: Sequence[str]) -> str:
    link = f"{row['name']}/report.html"
    name = html.escape(row["name"])
    first = f'<a href="{html.escape(link)}">{name}</a>' if "report.html" in row["outputs"] else name
    figures = [row["headline"].get(figure, "") for figure in names]
    remark = (row["error"] or "").strip().splitlines()[-1:]
    cells = [first, *(html.escape(cell) for cell in (row["status"], *figures, *(remark or [""])))]
    return "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"

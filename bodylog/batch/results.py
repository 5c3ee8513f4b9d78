"""What a batch leaves: results.jsonl as it goes, then in name order; junit.xml for CI; summary.html for people."""

import html
import json
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ..files import replacing
from .jobs import Row

ODD = "backslashreplace"
"""What becomes of a file name that is no text: in JSON what it is read back from."""


@contextmanager
def journal(out: Path) -> Iterator[Callable[[Row], None]]:
    """A function that appends one row to results.jsonl at once, so that an interrupted batch shows what it did."""
    with (out / "results.jsonl").open("w", encoding="utf-8", errors=ODD) as stream:

        def write(row: Row) -> None:
            stream.write(line(row))
            stream.flush()

        yield write


def line(row: Row) -> str:
    """A row as one line of JSON, keys in order."""
    return json.dumps(row, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"


def write(out: Path, rows: Sequence[Row]) -> None:
    """All three files, whole, rows in the order given."""
    for name, text in (
        ("results.jsonl", "".join(line(row) for row in rows)),
        ("junit.xml", junit(rows)),
        ("summary.html", summary(rows)),
    ):
        with replacing(out / name) as beside:
            beside.write_text(text, encoding="utf-8", errors=ODD)


def junit(rows: Sequence[Row]) -> str:
    """JUnit XML: a broken bound is a failure; an unusable log, a bug or a log not reached is an error."""
    failures = sum(row["exit_code"] == 4 for row in rows)
    errors = sum(row["exit_code"] in (1, 65) for row in rows)
    counts = {"tests": str(len(rows)), "failures": str(failures), "errors": str(errors)}
    suites = ET.Element("testsuites", {"name": "bodylog", **counts})
    suite = ET.SubElement(suites, "testsuite", {"name": "bodylog batch", **counts, "skipped": "0"})
    for row in rows:
        _case(suite, row)
    ET.indent(suites)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(suites, encoding="unicode") + "\n"


def _case(suite: ET.Element, row: Row) -> None:
    case = ET.SubElement(suite, "testcase", {"classname": "bodylog", "name": _xml(row["name"])})
    if row["exit_code"] in (1, 4, 65):
        kind = "failure" if row["exit_code"] == 4 else "error"
        first = _xml(row["error"]).strip().splitlines()[-1]
        ET.SubElement(case, kind, {"message": first, "type": row["status"]}).text = _xml(row["error"])
    scores = "\n".join(f"{name} = {value}" for name, value in row["scores"].items())
    remarks = "\n".join(f"{severity}: {text}" for severity, text in row["findings"])
    ET.SubElement(case, "system-out").text = _xml(f"{row['log']}\n{scores}\n{remarks}")


def _xml(text: str) -> str:
    """Text without the control characters XML 1.0 cannot hold."""
    return "".join(c if c in "\t\n" or " " <= c <= "\ud7ff" or "\ue000" <= c <= "\ufffd" else "�" for c in text)


def summary(rows: Sequence[Row]) -> str:
    """A page with one line per log; everything from a log is escaped."""
    names = sorted({name for row in rows for name in row["scores"] if "/" not in name})
    head = "".join(f"<th>{html.escape(name)}</th>" for name in ("log", "status", *names, "remark"))
    body = "\n".join(_line(row, names) for row in rows)
    return PAGE.format(count=len(rows), head=head, body=body)


PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>bodylog batch</title>
<style>
body{{font:14px sans-serif;margin:2em}} td,th{{padding:.2em .8em;text-align:left;border-bottom:1px solid #ddd}}
</style>
<h1>{count} logs</h1>
<table><tr>{head}</tr>
{body}
</table></html>
"""


def _line(row: Row, names: Sequence[str]) -> str:
    link = f"{row['name']}/report.html"
    name = html.escape(row["name"])
    first = f'<a href="{html.escape(link)}">{name}</a>' if "report.html" in row["outputs"] else name
    scores = [f"{v:.5g}" if (v := row["scores"].get(score)) is not None else "" for score in names]
    remark = (row["error"] or "").strip().splitlines()[-1:]
    cells = [first, *(html.escape(cell) for cell in (row["status"], *scores, *(remark or [""])))]
    return "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"

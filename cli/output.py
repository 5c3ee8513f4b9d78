"""How results are shown: verdicts and tables on standard
output, warnings and progress on standard error; --json.
"""

import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from bodylog.logs.protocol import Progress
    from bodylog.pipeline import Result
    from bodylog.settings import Settings
    from bodylog.types import Finding, Score

T = TypeVar("T")
R = TypeVar("R")
VERBOSITY = "bodylog.verbosity"
"""Key in a command's meta: -1 errors alone, 0 warnings too, 1 everything."""
COPIES = "bodylog.copies"
"""Key in a command's meta: the URLs of fetched logs by the paths of their copies."""


def print_result(
    result: "Result", source: Any, as_json: bool, full: bool = False, **further: Any
) -> int:
    """Print a result and return the exit code: 3 when part of the input was lost, else 0.

    `source` is what the command read · `full`: print
    the scores too · `further`: keys for --json alone.
    """
    if as_json:
        print_json([result_entry(result, source) | further])
        print_findings(result.findings)
        return exit_code_of_findings(result.findings)
    print_verdict(result)
    if full and read_verbosity() >= 0:
        print_score_table({"": result.scores})
    if result.output is not None and read_verbosity() >= 0:
        print_line(f"wrote {result.output}", err=True)
    return exit_code_of_findings(result.findings)


def print_verdict(result: "Result") -> None:
    """Print a result's verdict, then the findings that it does not hold."""
    from bodylog.findings.faults import fault_warnings

    for text in result.verdict if read_verbosity() >= 0 else ():
        print_line(text)
    held = fault_warnings(result.faults) if result.verdict else ()
    print_findings(
        [one for one in result.findings if one not in held and one.text not in result.verdict]
    )


def read_verbosity() -> int:
    """-1 after -q, 1 after -v, else 0."""
    context = click.get_current_context(silent=True)
    return 0 if context is None else int(context.meta.get(VERBOSITY, 0))


def collect_results(logs: Sequence[T], look: Callable[[T], R]) -> tuple[dict[str, R], int]:
    """Results by path, and an exit code: among several logs
    one that cannot be used is an error line, not the end.
    """
    from bodylog.errors import InputError

    found = {}
    code = 0
    for log in logs:
        try:
            found[str(log)] = look(log)
        except InputError as problem:
            if len(logs) == 1:
                raise
            print_error(problem)
            code = problem.exit_code
    return found, code


def print_error(problem: Exception) -> None:
    """Print one line on standard error; nothing while a signal ends the process."""
    from bodylog.runtime import signals

    if not signals.received_signal():
        print_line(f"bodylog: {' '.join(str(problem).split())}", err=True)


def print_line(text: str, err: bool = False) -> None:
    """Print one line; control characters, which names in a log may hold, as their codes."""
    plain = (
        c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode()
        for c in as_typed(text)
    )
    try:
        click.echo("".join(plain), err=err)
    except OSError:
        if not err:
            raise
        # nobody reads it: the work goes on
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


def as_typed(text: str) -> str:
    """Text that names copies of fetched logs, with their URLs instead."""
    context = click.get_current_context(silent=True)
    for copy, url in () if context is None else context.meta.get(COPIES, {}).items():
        text = text.replace(copy, url)
    return text


def result_entry(result: "Result", source: Any) -> dict[str, Any]:
    """A result as one of --json's `results`; `source` is its input, or a list of them."""
    return {
        "input": [str(one) for one in source]
        if isinstance(source, list | tuple)
        else source and str(source),
        "output": None if result.output is None else str(result.output),
        "verdict": list(result.verdict),
        "scores": scores_by_name(result.scores),
        "health": {topic: asdict(health) for topic, health in result.health.items()},
        "findings": [asdict(finding) for finding in dict.fromkeys(result.findings)],
        "faults": [
            {**asdict(fault), "alternatives": list(fault.alternatives)} for fault in result.faults
        ],
        "settings": result.settings,
    }


def scores_by_name(scores: "Sequence[Score]") -> dict[str, dict[str, Any]]:
    """{name: {"value", "unit"}}, and "std" where it is known."""
    return {
        score.name: {"value": score.value, "unit": score.unit}
        | ({} if score.std is None else {"std": score.std})
        for score in scores
    }


def print_json(results: Sequence[Mapping[str, Any]]) -> None:
    """Print --json's envelope; NaN, which JSON lacks, becomes null."""
    from bodylog.version import __version__

    context = click.get_current_context(silent=True)
    whole = {
        "bodylog": __version__,
        "command": context and context.command.name,
        "results": results,
    }
    click.echo(json.dumps(_replace_nan(whole), indent=2, default=str))


def _replace_nan(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {as_typed(str(key)): _replace_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_replace_nan(item) for item in value]
    if hasattr(value, "tolist"):
        return _replace_nan(value.tolist())
    if isinstance(value, str | os.PathLike):
        return as_typed(os.fspath(value))
    return (
        None
        if isinstance(value, float) and (value != value or abs(value) == float("inf"))
        else value
    )


def print_findings(findings: "Sequence[Finding]", about: str = "") -> None:
    """Print each finding once on standard error:
    losses, unless -q warnings, with -v information too.
    """
    shown = (("lost",), ("lost", "warning"), ("lost", "warning", "info"))[read_verbosity() + 1]
    for finding in dict.fromkeys(findings):
        if finding.severity in shown:
            print_line(f"{finding.severity}: {about}{finding.text}", err=True)


def exit_code_of_findings(findings: "Sequence[Finding]") -> int:
    """Exit code: 3 when part of the input was lost, else 0."""
    return 3 if any(finding.severity == "lost" for finding in findings) else 0


def print_score_table(results: "Mapping[str, Sequence[Score]]") -> None:
    """Print scores by name with their units: a column per result, named where there are several."""
    values = {path: {score.name: score for score in scores} for path, scores in results.items()}
    units = {score.name: score.unit for scores in results.values() for score in scores}
    head = [("score", "unit", *values)] if len(values) > 1 else []
    rows = [
        (name, unit, *(_score_cell(of.get(name)) for of in values.values()))
        for name, unit in units.items()
    ]
    print_columns([*head, *rows], left=2)


def _score_cell(score: "Score | None") -> str:
    return "-" if score is None else f"{score.value:.6g}"


def print_columns(rows: Sequence[Sequence[str]], left: int) -> None:
    """Print rows in aligned columns, the first `left` of them to the left."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = [
            f"{c:<{w}}" if k < left else f"{c:>{w}}"
            for k, (c, w) in enumerate(zip(row, widths, strict=True))
        ]
        print_line("  ".join(cells).rstrip())


@contextmanager
def show_progress(
    what: str,
    logs: Sequence[Any] = (),
    settings: "Settings | None" = None,
    unit: str = "images",
    count: "Callable[[Any], int] | None" = None,
) -> "Iterator[Progress | None]":
    """A bar of images, messages or steps on a terminal, nothing
    otherwise; call what it yields with how many are done.

    The total is what `count` gives for each of `logs`, else all messages, or the cameras' images,
    in them; where it is not known, the bar counts.
    """
    if not sys.stderr.isatty() or read_verbosity() < 0:
        yield None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
    )
    from rich.progress import Progress as Bar

    columns = (
        SpinnerColumn(),
        TextColumn(what),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
    )
    with Bar(*columns, TimeElapsedColumn(), console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=_count_total(logs, settings, unit, count) or None)
        yield lambda frames: bar.advance(task, frames)


def _count_total(
    logs: Sequence[Any],
    settings: "Settings | None",
    unit: str,
    count: "Callable[[Any], int] | None",
) -> int:
    """What `count` gives, or messages of all topics, or
    images of the cameras; 0 where a log cannot be read.
    """
    from bodylog.errors import BodylogError
    from bodylog.info import describe_file

    total = 0
    try:
        if count is not None:
            return sum(map(count, logs))
        for found in (describe_file(log, settings) for log in logs if settings is not None):
            cameras = {
                topic
                for role, topic in found.get("roles", {}).items()
                if role.partition("/")[0] == "camera"
            }
            total += sum(
                topic["messages"]
                for topic in found.get("topics", ())
                if unit == "messages" or topic["topic"] in cameras
            )
    except (BodylogError, OSError):
        return 0
    return total

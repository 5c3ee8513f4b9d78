"""How results are shown: data on standard output, talk on standard error."""

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from bodylog.pipeline import Progress, Result
    from bodylog.types import Finding, Score


def show(result: "Result", as_json: bool, quiet: bool = False) -> int:
    """Print a result and return the exit code: 3 when part of the input was lost, else 0; `quiet` is for talk."""
    talk(result.findings, quiet)
    if as_json:
        data(as_data(result))
    else:
        table(() if quiet else result.scores)
        if result.output is not None:
            click.echo(f"wrote {result.output}", err=True)
    return lost(result.findings)


def as_data(result: "Result") -> dict[str, Any]:
    """A result as the plain values of --json."""
    return {
        "output": None if result.output is None else str(result.output),
        "scores": [asdict(score) for score in result.scores],
        "health": {topic: asdict(health) for topic, health in result.health.items()},
        "findings": [asdict(finding) for finding in result.findings],
        "faults": [asdict(fault) for fault in result.faults],
        "settings": result.settings,
    }


def data(value: Any) -> None:
    """Print JSON; NaN, which JSON lacks, becomes null."""
    click.echo(json.dumps(_finite(value), indent=2, default=_plain))


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and (value != value or abs(value) == float("inf")) else value


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)


def talk(findings: "Sequence[Finding]", quiet: bool = False) -> None:
    """One line per finding, each once, on standard error; `quiet`: no mere information."""
    for finding in dict.fromkeys(findings):
        if not (quiet and finding.severity == "info"):
            click.echo(f"{finding.severity}: {finding.text}", err=True)


def lost(findings: "Sequence[Finding]") -> int:
    """Exit code: 3 when part of the input was lost, else 0."""
    return 3 if any(finding.severity == "lost" for finding in findings) else 0


def table(scores: "Sequence[Score]") -> None:
    """Scores in columns."""
    width = max((len(score.name) for score in scores), default=0)
    for score in scores:
        click.echo(f"{score.name:<{width}}  {score.value:>12.6g}  {score.unit}".rstrip())


@contextmanager
def progress(what: str) -> "Iterator[Progress | None]":
    """A counter of pictures on a terminal, nothing otherwise; what is yielded is told how many more are done."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress as Bar
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn(f"{what}: {{task.completed:.0f}} pictures"), TimeElapsedColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda frames: bar.advance(task, frames)

"""The page: readings, tables of verdicts, the paper's
figures redrawn with ours, and the data files.
"""

import base64
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from ..io import atomic_files
from ..report.page.data import panels_as_json
from ..report.page.template import plots_placeholder, render_document
from ..report.page.traces import Panel, PlotTrace
from ..types import Array
from ..version import __version__
from . import draw, figure_data
from .claims import DEPENDS, Claim
from .draw import TRUTH_PREFIXES
from .json_values import to_json_value
from .records import ExperimentReadings, Trial
from .table import EXPERIMENTS
from .tables import claim_tables, count_paper_verdicts, outcomes_table, plain_table, readings_table

TITLE = "The paper's experiments, reproduced"
MAX_PAGE_LINES = 8
"""Most lines of a panel on the page; data/ has all."""


def write_reproduction_page(
    out: Path,
    trials: Mapping[str, Sequence[Trial]],
    tried: Mapping[str, ExperimentReadings],
    seeds: int,
    size: str,
) -> tuple[Claim, ...]:
    """Write index.html, claims.json, data and figures, the same bytes for the same figures."""
    claims = {name: EXPERIMENTS[name].claims(found, tried[name]) for name, found in trials.items()}
    every = tuple(claim for found in claims.values() for claim in found)
    _save_text(out / "claims.json", _claim_json([asdict(claim) for claim in every]))
    figure_data.write_figure_data(out, trials, every)
    _save_text(out / "index.html", render_page(trials, claims, seeds, size, out))
    return every


def render_page(
    trials: Mapping[str, Sequence[Trial]],
    claims: Mapping[str, Sequence[Claim]],
    seeds: int,
    size: str,
    out: Path,
) -> str:
    """The page as text; figures are written beside it, those over all seeds embedded."""
    every = [claim for found in claims.values() for claim in found]
    command = f"bodylog reproduce {' '.join(trials)} -o DIR --seeds {seeds}"
    parts = [
        f"<h1>{TITLE}</h1>",
        "<p>Lanillos &amp; Cheng, <i>Adaptive robot body learning and estimation through "
        "predictive coding</i> "
        "(IROS 2018), from simulated logs. A claim is a bound on a figure, with controls. A "
        "reading of what the paper "
        "leaves open does not test a claim where the model diverges or a control fails. It "
        "keeps a claim that nine of "
        "ten seeds keep. A claim of the paper is <b>kept</b> or <b>refuted</b> by every "
        "reading that tests it, "
        "<b>depends on</b> some constants, is <b>not tested</b> by any reading, or is <b>not "
        "testable here</b>.</p>",
        f'<p class="soft">{escape(command)} · bodylog {escape(__version__)} · images '
        f"{escape(size)}</p>",
        f"<p>{len(every)} claims; of the paper's: {_verdict_counts_text(every)}.</p>",
        claim_tables(every),
        readings_table(),
    ]
    parts += [_experiment_section(name, trials[name], claims[name], out) for name in trials]
    groups = [
        panels_as_json(_page_panels(found[0]["panels"]), (), 0.0)
        for found in trials.values()
        if found[0]["panels"]
    ]
    return render_document(TITLE, "\n".join(parts), groups)


def _verdict_counts_text(claims: Sequence[Claim]) -> str:
    return (
        ", ".join(f"{count} {verdict}" for verdict, count in count_paper_verdicts(claims).items())
        or "none"
    )


def _page_panels(shown: Sequence[Mapping[str, Any]]) -> list[Panel]:
    """The panels of one seed (see `records.build_panel`) over time for the page, two across."""
    return [
        Panel(f"{_numbered_title(one)}, {one['unit']}", _page_traces(one), half=True)
        for one in shown
    ]


def _numbered_title(one: Mapping[str, Any]) -> str:
    figure = one.get("figure", "")
    axis = one.get("axis", "s")
    return (f"Fig. {figure} {one['title']}" if figure else str(one["title"])) + (
        "" if axis == "s" else f" (over {axis})"
    )


def _page_traces(shown: Mapping[str, Any]) -> tuple[PlotTrace, ...]:
    t = np.asarray(shown["t"], float)
    lines = {
        name: np.array([np.nan if v is None else v for v in line])
        for name, line in shown["lines"].items()
    }
    few = list(lines.items())[:MAX_PAGE_LINES]
    return tuple(_page_trace(name, t, y, k) for k, (name, y) in enumerate(few))


def _page_trace(name: str, t: Array, y: Array, k: int) -> PlotTrace:
    real = name.startswith(TRUTH_PREFIXES)
    return PlotTrace(
        name, "truth" if name == "truth" else f"c{k % 8}", t, y, "dashes" if real else "line"
    )


def _experiment_section(
    name: str, trials: Sequence[Trial], claims: Sequence[Claim], out: Path
) -> str:
    experiment = EXPERIMENTS[name]
    parts = [f'<h2 id="{escape(name)}">{escape(name)}: {escape(experiment.title)}</h2>']
    parts += [plain_table(table) for table in experiment.tables(trials)]
    if trials[0]["panels"]:
        path = _write_figure(
            out, f"{name}, first seed", partial(draw.draw_traces, trials[0]["panels"])
        )
        note = (
            f"First seed, numbered as the paper's figures; drawn in figures/{path.name}, all in "
            f"data/{name}.csv."
        )
        parts.append(plots_placeholder((note,)))
    return "\n".join([*parts, *_figures_over_seeds(name, claims, out)])


def _figures_over_seeds(name: str, claims: Sequence[Claim], out: Path) -> list[str]:
    parts = []
    if any(claim.outcomes for claim in claims):
        title = f"{name}, all seeds"
        parts.append(
            _embedded_image(_write_figure(out, title, partial(draw.draw_spreads, claims)), title)
        )
    if any(claim.sweeps for claim in claims):
        title = f"{name}, swept"
        parts.append(
            _embedded_image(_write_figure(out, title, partial(draw.draw_sweeps, claims)), title)
        )
    detailed = [claim for claim in claims if claim.kind == "paper" and claim.outcomes]
    parts += [_claim_details(claim) for claim in detailed]
    return parts


def _claim_details(claim: Claim) -> str:
    opened = " open" if claim.verdict.startswith(DEPENDS) else ""
    tried = f"<summary>{escape(claim.id)} by reading: {escape(claim.verdict)}</summary>"
    return f"<details{opened}>{tried}{outcomes_table(claim)}</details>"


def _embedded_image(path: Path, title: str) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<p><img alt="{escape(title)}" src="data:image/png;base64,{data}"></p>'


def _write_figure(out: Path, title: str, make: Callable[[Path], None]) -> Path:
    """The figure as PNG, and beside it as SVG."""
    folder = out / "figures"
    folder.mkdir(exist_ok=True)
    path = folder / f"{title.replace(', ', '-').replace(' ', '-')}.png"
    make(path)
    return path


def _claim_json(value: Any) -> str:
    """JSON, as `to_json_value` writes numbers that are not finite."""
    return json.dumps(to_json_value(value), indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def _save_text(path: Path, text: str) -> None:
    with atomic_files.replace_atomically(path) as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")

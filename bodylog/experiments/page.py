"""The page: readings, tables of verdicts, the figures, and the data files."""

import base64
import csv
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ..io import atomic_files
from ..recording.tables import choose_table_writer
from ..report.figures.canvas import LINES, open_figure
from ..report.page.data import panels_as_json
from ..report.page.template import plots_placeholder, render_document
from ..report.page.traces import Panel, PlotTrace
from ..types import Array
from ..version import __version__
from .claims import DEPENDS, KEPT, REFUTED, UNTESTED, Claim, Outcome
from .json_values import to_json_value
from .records import ExperimentReadings, Trial
from .table import EXPERIMENTS
from .tables import claim_tables, count_paper_verdicts, outcomes_table, plain_table, readings_table

TITLE = "The paper's experiments, reproduced"
MAX_PAGE_LINES = 8
"""Most lines of a panel on the page; data/ has all."""
Columns = Mapping[str, Array]
INK = {KEPT: "#2a9d68", REFUTED: "#d1495b", UNTESTED: "#8a94a0"}
"""Colour of a reading by what it does to the claim."""
LOG_AXIS_RATIO = 30.0
"""Figures whose sizes differ by more are drawn on a logarithmic axis."""
TRUTH_PREFIXES = ("true ", "truth")
"""Prefixes of ground truth's lines, which are dashed."""
MAX_LEGEND_LINES = 10
"""Most lines of a panel that a legend names."""
_ACROSS = 2
BOTH = (".svg",)
"""What every figure is written as besides."""


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
    atomic_files.write_text_atomically(
        out / "claims.json", _claim_json([asdict(claim) for claim in every])
    )
    write_figure_data(out, trials, every)
    atomic_files.write_text_atomically(
        out / "index.html", render_page(trials, claims, seeds, size, out)
    )
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
        path = _write_figure(out, f"{name}, first seed", partial(draw_traces, trials[0]["panels"]))
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
            _embedded_image(_write_figure(out, title, partial(draw_spreads, claims)), title)
        )
    if any(claim.sweeps for claim in claims):
        title = f"{name}, swept"
        parts.append(
            _embedded_image(_write_figure(out, title, partial(draw_sweeps, claims)), title)
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


def draw_traces(panels: Sequence[Mapping[str, Any]], out: Path) -> None:
    """Draw panels (see `records.build_panel`) two across."""
    rows = -(-len(panels) // _ACROSS)
    with open_figure(out, 9.0, 2.4 * rows + 0.2, BOTH) as drawing:
        axes = drawing.subplots(rows, _ACROSS, squeeze=False)
        for axis, shown in zip(axes.flat, panels, strict=False):
            _draw_panel_traces(axis, shown)
        for axis in list(axes.flat)[len(panels) :]:
            axis.set_axis_off()


def _draw_panel_traces(axis: Any, shown: Mapping[str, Any]) -> None:
    for index, (name, line) in enumerate(shown["lines"].items()):
        values = [np.nan if v is None else v for v in line]
        style = "--" if name.startswith(TRUTH_PREFIXES) or name.endswith("truth") else "-"
        axis.plot(shown["t"], values, color=LINES[index % len(LINES)], label=name, ls=style)
    figure_of = f"Fig. {shown['figure']} " if shown["figure"] else ""
    axis.set_title(figure_of + shown["title"])
    axis.set_xlabel(shown["axis"])
    axis.set_ylabel(shown["unit"])
    if len(shown["lines"]) <= MAX_LEGEND_LINES:
        axis.legend(fontsize=7)


def draw_spreads(claims: Sequence[Claim], out: Path) -> None:
    """One strip per claim: a dot per reading with its
    interval, coloured by its state, and the bound.
    """
    shown = [claim for claim in claims if claim.outcomes]
    heights = [0.55 + 0.11 * len(claim.outcomes) for claim in shown]
    with open_figure(out, 9.0, sum(heights) + 0.4, BOTH) as drawing:
        axes = drawing.subplots(
            len(shown), 1, squeeze=False, gridspec_kw={"height_ratios": heights}
        )
        for axis, claim in zip(axes.flat, shown, strict=True):
            _draw_claim_strip(axis, claim)


def _draw_claim_strip(axis: Any, claim: Claim) -> None:
    found = list(claim.outcomes.values())
    for row, one in enumerate(found):
        axis.plot(one.interval, [-row, -row], "-", lw=1.0, color=_outcome_colour(one))
        axis.plot([one.median], [-row], "o", ms=4, color=_outcome_colour(one), mew=0)
    limit = float(claim.bound.split()[1])
    axis.axvline(limit, color="#20262e", lw=1.0, ls=":")
    axis.set_yticks(range(0, -len(found), -1), list(claim.outcomes), fontsize=5)
    axis.set_ylim(-len(found) + 0.4, 0.6)
    _scale_axis(axis, np.array([one.median for one in found] + [limit]))
    unit = "" if claim.unit == "1" else f" {claim.unit}"
    axis.set_title(f"{claim.id} {claim.measured}: {claim.bound}{unit}", fontsize=8)


def draw_sweeps(claims: Sequence[Claim], out: Path) -> None:
    """A panel per claim and constant it depends on: medians
    with intervals over the numbers swept, and the bound.
    """
    shown = [(claim, name, rows) for claim in claims for name, rows in claim.sweeps.items()]
    rows = -(-len(shown) // _ACROSS)
    with open_figure(out, 9.0, 2.2 * rows + 0.2, BOTH) as drawing:
        axes = drawing.subplots(rows, _ACROSS, squeeze=False)
        for axis, (claim, name, swept) in zip(axes.flat, shown, strict=False):
            _draw_claim_sweep(axis, claim, name, swept)
        for axis in list(axes.flat)[len(shown) :]:
            axis.set_axis_off()


def _draw_claim_sweep(
    axis: Any, claim: Claim, name: str, swept: Sequence[tuple[float, Outcome]]
) -> None:
    from .readings import CONSTANTS

    for number, one in swept:
        axis.plot([number, number], one.interval, "-", lw=1.0, color=_outcome_colour(one))
        axis.plot([number], [one.median], "o", ms=4, color=_outcome_colour(one), mew=0)
    limit = float(claim.bound.split()[1])
    axis.axhline(limit, color="#20262e", lw=1.0, ls=":")
    axis.set_xscale("log")
    values = np.array([one.median for _, one in swept] + [limit])
    if _spans_wide_range(values):
        axis.set_yscale("symlog", linthresh=_linear_threshold(values))
    axis.set_xlabel(f"{CONSTANTS[name].symbol}: {CONSTANTS[name].unit}")
    axis.set_title(f"{claim.id} {claim.measured}", fontsize=8)


def _outcome_colour(one: Outcome) -> str:
    return INK[one.state]


def _scale_axis(axis: Any, values: Any) -> None:
    """Logarithmic where the figures span more than
    LOG_AXIS_RATIO, linear around zero; ticks are plain numbers.
    """
    if _spans_wide_range(values):
        axis.set_xscale("symlog", linthresh=_linear_threshold(values))
    axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")


def _nonzero_sizes(values: Any) -> Any:
    return np.abs(values[np.isfinite(values) & (values != 0.0)])


def _spans_wide_range(values: Any) -> bool:
    sizes = _nonzero_sizes(values)
    return bool(len(sizes) and sizes.max() > LOG_AXIS_RATIO * sizes.min())


def _linear_threshold(values: Any) -> float:
    return max(float(_nonzero_sizes(values).min()), 1e-3)

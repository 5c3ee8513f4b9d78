"""The figures, as PNG and SVG: the paper's redrawn from
one seed, every claim's outcomes by reading, and sweeps.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..report.figures.canvas import LINES, open_figure
from .claims import KEPT, REFUTED, UNTESTED, Claim, Outcome

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

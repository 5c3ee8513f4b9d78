"""The figures of an experiment: one seed over time as in the paper, and every claim's figures over all seeds."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..report.canvas import LINES, figure
from .records import Claim, Trial, column

SIDES = {"printed": "#d1495b", "ours": "#1f77d0"}
WIDE = 30.0
"""Figures whose sizes differ by more are drawn on a logarithmic axis."""
REAL = ("true ", "truth")
"""How the lines of what really was begin; they are drawn in dashes."""
_ACROSS = 2


def traces(panels: Sequence[Mapping[str, Any]], out: Path) -> None:
    """Draw panels (see `records.panel`) two across."""
    rows = -(-len(panels) // _ACROSS)
    with figure(out, 9.0, 2.4 * rows + 0.2) as drawing:
        axes = drawing.subplots(rows, _ACROSS, squeeze=False)
        for axis, shown in zip(axes.flat, panels, strict=False):
            _trace(axis, shown)
        for axis in list(axes.flat)[len(panels):]:
            axis.set_axis_off()


def _trace(axis: Any, shown: Mapping[str, Any]) -> None:
    for index, (name, line) in enumerate(shown["lines"].items()):
        values = [np.nan if v is None else v for v in line]
        style = "--" if name.startswith(REAL) else "-"
        axis.plot(shown["t"], values, color=LINES[index % len(LINES)], label=name, ls=style)
    axis.set_title(shown["title"])
    axis.set_xlabel("s")
    axis.set_ylabel(shown["unit"])
    axis.legend(fontsize=7)


def curves(trials: Sequence[Trial], out: Path) -> None:
    """Measured costs by size, a line for each thing that grows, with its exponent: medians over the seeds."""
    found: dict[str, dict[int, float]] = {}
    for name in trials[0]["figures"]:
        what, _, size = name.rpartition(" ")
        if size.isdigit():
            found.setdefault(what, {})[int(size)] = float(np.median(column(trials, name)))
    with figure(out, 7.0, 4.0) as drawing:
        axis = drawing.subplots()
        for index, (what, costs) in enumerate(sorted(found.items())):
            power = float(np.median(column(trials, f"{what} exponent")))
            sizes = sorted(costs)
            label = f"{what}: exponent {power:.2f}"
            axis.loglog(sizes, [1e6 * costs[n] for n in sizes], "o-", color=LINES[index % len(LINES)], label=label)
        axis.set_xlabel("samples, senses or joints")
        axis.set_ylabel("µs")
        axis.legend(fontsize=7)


def spreads(claims: Sequence[Claim], out: Path) -> None:
    """One strip per claim: a dot per seed, printed above ours, and the bound."""
    with figure(out, 9.0, 0.75 * len(claims) + 0.6) as drawing:
        axes = drawing.subplots(len(claims), 1, squeeze=False)
        for index, (axis, claim) in enumerate(zip(axes.flat, claims, strict=True), 1):
            _strip(axis, claim, index)


def _strip(axis: Any, claim: Claim, index: int) -> None:
    limit = float(claim.bound.split()[1])
    for row, (side, colour) in enumerate(SIDES.items()):
        values = np.asarray(getattr(claim, side), float)
        values = values[np.isfinite(values)]
        axis.plot(values, np.full(len(values), -row), "o", ms=4, alpha=0.6, color=colour, mew=0)
    axis.axvline(limit, color="#20262e", lw=1.0, ls=":")
    axis.set_yticks([0, -1], ["printed", "ours"])
    axis.set_ylim(-1.6, 0.6)
    _scale(axis, np.concatenate([np.asarray([*claim.printed, *claim.ours], float), [limit]]))
    unit = "" if claim.unit == "1" else f" {claim.unit}"
    axis.set_title(f"{index}. {claim.measured}: {claim.bound}{unit}", fontsize=8)


def _scale(axis: Any, values: Any) -> None:
    """Logarithmic where the figures span more than WIDE, linear around zero; ticks are plain numbers."""
    sizes = np.abs(values[np.isfinite(values) & (values != 0.0)])
    if len(sizes) and sizes.max() > WIDE * sizes.min():
        axis.set_xscale("symlog", linthresh=max(float(sizes.min()), 1e-3))
    axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")

"""Records of an experiment, of one seed's result, and access to figures over all seeds."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from .claims import Claim
from .judging import Figures, Swept
from .readings import CENTRE, Reading, reading_key, restrict_readings

if TYPE_CHECKING:
    from .lab import Lab

Trial = Mapping[str, Any]
"""One seed's result as plain values: {"figures": {name: number}, "panels": [panel, …]}."""


@dataclass(frozen=True)
class ExperimentReadings:
    """The readings of an experiment: those that decide, and those that sweep one constant each."""

    decide: tuple[Reading, ...]
    sweep: tuple[tuple[str, float, Reading], ...] = ()

    @property
    def all(self) -> tuple[Reading, ...]:
        """Both kinds, each reading once."""
        found = {
            reading_key(reading): reading
            for reading in (*self.decide, *(r for _, _, r in self.sweep))
        }
        return tuple(found.values())

    def restricted(self, *names: str) -> "ExperimentReadings":
        """The readings of these constants alone."""
        return ExperimentReadings(
            restrict_readings(self.decide, names),
            tuple(row for row in self.sweep if row[0] in names),
        )

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of the readings that decide."""
        return tuple(reading_key(reading) for reading in self.decide)

    @property
    def swept(self) -> tuple[Swept, ...]:
        """The readings that sweep, as `judging.judge_paper_claim` takes them."""
        return tuple((name, number, reading_key(reading)) for name, number, reading in self.sweep)


@dataclass(frozen=True)
class Experiment:
    """An experiment: name, title, function that runs one
    seed in some readings, and claims over all seeds.

    concerned: the open constants that its claims may
    depend on; () if it does not run the paper's model.
    """

    name: str
    title: str
    run: "Callable[[Lab, int, ExperimentReadings], Trial]"
    claims: Callable[[Sequence[Trial], ExperimentReadings], tuple[Claim, ...]]
    concerned: tuple[str, ...] = ()
    tables: Callable[[Sequence[Trial]], "tuple[TextTable, ...]"] = field(default=lambda trials: ())


@dataclass(frozen=True)
class TextTable:
    """A table of the page: caption, head, rows of text."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def name_figure(reading: str, figure: str) -> str:
    """The name of a reading's figure in a trial."""
    return f"{reading} | {figure}"


def by_reading(trials: Sequence[Trial]) -> Figures:
    """A trial's figures by reading and name."""
    return lambda reading, figure: figure_column(trials, name_figure(reading, figure))


def shown_reading_key(trials: Sequence[Trial]) -> str:
    """The key of the reading that tables and figures show: the centre, or the requested one."""
    found = sorted({name.partition(" | ")[0] for name in trials[0]["figures"] if " | " in name})
    return CENTRE if CENTRE in found or not found else found[0]


def figure_ratios(trials: Sequence[Trial], more: str, fewer: str) -> list[float]:
    """One figure over another, of every seed."""
    columns = figure_column(trials, more), figure_column(trials, fewer)
    return [a / b for a, b in zip(*columns, strict=True)]


def figure_column(trials: Sequence[Trial], name: str) -> tuple[float, ...]:
    """One figure of every seed; JSON's null is NaN."""
    found = (trial["figures"][name] for trial in trials)
    return tuple(float("nan") if value is None else float(value) for value in found)


def build_panel(
    title: str,
    unit: str,
    t: Any,
    lines: Mapping[str, Any],
    figure: str = "",
    axis: str = "s",
    most: int = 240,
) -> dict[str, Any]:
    """A plot over t (N,) for the page: lines {label: (N,)}, thinned to at most `most` points.

    figure: the number of the paper's figure it redraws, such as "4a"; axis: what t is.
    """
    rows = np.unique(np.linspace(0, len(t) - 1, min(len(t), most)).astype(int))
    drawn = {
        name: [round(float(v), 6) for v in np.asarray(line)[rows]] for name, line in lines.items()
    }
    shown = [round(float(v), 4) for v in np.asarray(t)[rows]]
    return {
        "title": title,
        "unit": unit,
        "axis": axis,
        "figure": figure,
        "t": shown,
        "lines": drawn,
    }

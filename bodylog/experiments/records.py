"""What an experiment is, what one seed of it found, and how a claim is judged over all seeds."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from .lab import Lab

SIDES = ("printed", "ours")
"""The printed model, its errata applied, and our default."""
SHARE = 0.9
"""A claim holds when it does in at least this share of the seeds."""

Trial = Mapping[str, Any]
"""What one seed found, as plain values: {"figures": {name: number}, "panels": [panel, …]}."""


@dataclass(frozen=True)
class Bound:
    """What a figure must be for the claim to hold: at most or at least a limit."""

    sign: str
    limit: float

    def holds(self, figures: Sequence[float]) -> float:
        """Share of the figures within the bound; one that is not a number is not."""
        values = np.asarray(figures, float)
        inside = values <= self.limit if self.sign == "≤" else values >= self.limit
        return float(inside.mean()) if len(values) else 0.0

    def __str__(self) -> str:
        """As read on the page."""
        return f"{self.sign} {self.limit:g}"


@dataclass(frozen=True)
class Claim:
    """One sentence to be confirmed, refuted or corrected: figures per seed of the printed model and of ours."""

    experiment: str
    text: str
    measured: str
    unit: str
    bound: str
    verdict: str
    printed: tuple[float, ...]
    ours: tuple[float, ...]
    spread: Mapping[str, tuple[float, float, float]]
    share: Mapping[str, float]
    explanation: str = ""


@dataclass(frozen=True)
class Experiment:
    """An experiment: its name, what it is about, one seed of it, and what all seeds say."""

    name: str
    title: str
    run: "Callable[[Lab, int], Trial]"
    claims: Callable[[Sequence[Trial]], tuple[Claim, ...]]
    tables: Callable[[Sequence[Trial]], "tuple[Table, ...]"] = field(default=lambda trials: ())


@dataclass(frozen=True)
class Table:
    """A table of the page: caption, head, rows of text."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def judge(
    experiment: str, text: str, measured: str, unit: str, bound: Bound,
    figures: tuple[Sequence[float], Sequence[float]], explanation: str = "",
) -> Claim:  # fmt: skip
    """Of the printed model's figures and ours: confirmed when the former are in bound, corrected when only the latter.

    Refuted when neither are.
    """
    printed, ours = figures
    share = {"printed": bound.holds(printed), "ours": bound.holds(ours)}
    verdict = "confirmed" if share["printed"] >= SHARE else "corrected" if share["ours"] >= SHARE else "refuted"
    spread = {"printed": spread_of(printed), "ours": spread_of(ours)}
    plain = (tuple(float(v) for v in printed), tuple(float(v) for v in ours))
    return Claim(experiment, text, measured, unit, str(bound), verdict, *plain, spread, share, explanation)


def spread_of(figures: Sequence[float]) -> tuple[float, float, float]:
    """Median, least and greatest of the figures that are numbers; NaN where none is."""
    values = np.asarray(figures, float)
    values = values[np.isfinite(values)]
    if not len(values):
        return (float("nan"),) * 3
    return float(np.median(values)), float(values.min()), float(values.max())


def column(trials: Sequence[Trial], name: str) -> tuple[float, ...]:
    """One figure of every seed; null, which JSON has for what is not a number, is NaN."""
    found = (trial["figures"][name] for trial in trials)
    return tuple(float("nan") if value is None else float(value) for value in found)


def both(trials: Sequence[Trial], name: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """One figure of every seed, of either side."""
    return column(trials, f"printed {name}"), column(trials, f"ours {name}")


def ratio(trials: Sequence[Trial], more: str, less: str) -> list[float]:
    """One figure over another, by seed."""
    return [a / b for a, b in zip(column(trials, more), column(trials, less), strict=True)]


def medians(trials: Sequence[Trial], name: str, tried: Iterable[float]) -> dict[float, float]:
    """Of each constant tried the median over the seeds of the figure called `name`, in which {} is the constant."""
    return {value: float(np.nanmedian(column(trials, name.format(f"{value:g}")))) for value in tried}


def where(holds: Iterable[float], unit: str = "") -> str:
    """At which of the constants tried a claim holds, in words."""
    told = ", ".join(f"{value:g}" for value in holds)
    return f"it holds at {told}{unit}" if told else "it holds at none of them"


def errors_table(caption: str, trials: Sequence[Trial], senses: Iterable[str]) -> Table:
    """Median errors (rad) of either side by senses."""
    rows = [(name, *(f"{np.nanmedian(found):.4f}" for found in both(trials, name))) for name in senses]
    return Table(caption, ("senses", "printed model", "ours"), tuple(rows))


def panel(title: str, unit: str, t: Any, lines: Mapping[str, Any], most: int = 240) -> dict[str, Any]:
    """A plot over time t (N,) s for the page: lines {label: (N,)}, thinned to at most `most` points."""
    rows = np.unique(np.linspace(0, len(t) - 1, min(len(t), most)).astype(int))
    drawn = {name: [round(float(v), 6) for v in np.asarray(line)[rows]] for name, line in lines.items()}
    return {"title": title, "unit": unit, "t": [round(float(v), 4) for v in np.asarray(t)[rows]], "lines": drawn}


def jsonable(value: Any) -> Any:
    """The value without numpy in it; what is not a finite number is null."""
    if isinstance(value, Mapping):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [jsonable(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value

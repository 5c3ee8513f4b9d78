"""The page: every claim with its verdict and figures, the paper's figures redrawn, our answer beside."""

import base64
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__, files
from ..report.document import document, plots
from ..report.packing import plain
from ..report.traces import Panel, Trace
from ..types import Array
from . import draw
from .draw import REAL
from .records import Claim, Table, Trial, jsonable
from .table import EXPERIMENTS, TIMED


def write(out: Path, trials: Mapping[str, Sequence[Trial]], seeds: int, size: str) -> tuple[Claim, ...]:
    """Write index.html and claims.json, the same bytes for the same figures; what was timed goes to cost.json."""
    claims = {name: EXPERIMENTS[name].claims(found) for name, found in trials.items()}
    shown = {name: tuple(map(withheld, found)) if name in TIMED else found for name, found in claims.items()}
    _save(out / "claims.json", _json([asdict(claim) for found in shown.values() for claim in found]))
    timed = [name for name in trials if name in TIMED]
    if timed:
        _save(out / "cost.json", _json({name: [dict(t["figures"]) for t in trials[name]] for name in timed}))
    _save(out / "index.html", html(trials, shown, seeds, size, out))
    return tuple(claim for found in claims.values() for claim in found)


def withheld(claim: Claim) -> Claim:
    """A claim without its figures, which are times."""
    return replace(claim, printed=(), ours=(), spread={}, share={})


def html(
    trials: Mapping[str, Sequence[Trial]], claims: Mapping[str, Sequence[Claim]], seeds: int, size: str, out: Path
) -> str:
    """The page as text; figures are drawn beside it, those over all seeds taken in."""
    command = f"bodylog reproduce {' '.join(trials)} -o DIR --seeds {seeds}"
    parts = [
        "<h1>The paper's experiments, reproduced</h1>",
        '<p>Lanillos &amp; Cheng, <i>Adaptive robot body learning and estimation through predictive coding</i> '
        "(IROS 2018), from simulated logs. Every claim is a bound on a figure, asked of every seed: <b>confirmed</b> "
        "when the printed model, its errata applied, keeps it in nine of ten seeds, <b>corrected</b> when only "
        "our default does, <b>refuted</b> when neither does.</p>",
        f'<p class="soft">{escape(command)} · bodylog {escape(__version__)} · pictures {escape(size)}</p>',
        _summary(claims),
    ]
    parts += [_section(name, trials[name], claims[name], out) for name in trials]
    groups = [plain(_panels(found[0]["panels"]), (), 0.0) for found in trials.values() if found[0]["panels"]]
    return document("The paper's experiments, reproduced", "\n".join(parts), groups)


def _panels(shown: Sequence[Mapping[str, Any]]) -> list[Panel]:
    """The panels of one seed (see `records.panel`) for the page, two across."""
    return [Panel(f"{one['title']}, {one['unit']}", _traces(one), half=True) for one in shown]


def _traces(shown: Mapping[str, Any]) -> tuple[Trace, ...]:
    t = np.asarray(shown["t"], float)
    lines = {name: np.array([np.nan if v is None else v for v in line]) for name, line in shown["lines"].items()}
    return tuple(_trace(name, t, y, k) for k, (name, y) in enumerate(lines.items()))


def _trace(name: str, t: Array, y: Array, k: int) -> Trace:
    real = name.startswith(REAL)
    return Trace(name, "truth" if name == "truth" else f"c{k % 8}", t, y, "dashes" if real else "line")


def _summary(claims: Mapping[str, Sequence[Claim]]) -> str:
    every = [claim for found in claims.values() for claim in found]
    counts = {verdict: sum(c.verdict == verdict for c in every) for verdict in ("confirmed", "corrected", "refuted")}
    told = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    return f"<p>{len(every)} claims: {told}.</p>"


def _section(name: str, trials: Sequence[Trial], claims: Sequence[Claim], out: Path) -> str:
    experiment = EXPERIMENTS[name]
    parts = [f'<h2 id="{escape(name)}">{escape(name)}: {escape(experiment.title)}</h2>', claim_table(claims)]
    if name in TIMED:
        path = _figure(out, f"{name}, measured", partial(draw.curves, trials))
        kept = f"cost.json and drawn in figures/{path.name}, beside this page"
        parts.append(f'<p class="soft">Times differ from run to run and are kept in {kept}.</p>')
        return "\n".join(parts)
    parts += [_table(table) for table in experiment.tables(trials)]
    if trials[0]["panels"]:
        path = _figure(out, f"{name}, first seed", partial(draw.traces, trials[0]["panels"]))
        parts.append(plots((f"First seed; also drawn in figures/{path.name}.",)))
    title = f"{name}, all seeds"
    return "\n".join([*parts, _drawn(_figure(out, title, partial(draw.spreads, claims)), title)])


def claim_table(claims: Sequence[Claim]) -> str:
    """Claims as rows: what was said, what was measured, medians with least and greatest, verdict."""
    head = ("", "claim", "measured", "must be", "printed model", "ours", "verdict")
    rows = "".join(_claim(index, claim) for index, claim in enumerate(claims, 1))
    return f"<table><tr>{''.join(f'<th>{h}</th>' for h in head)}</tr>{rows}</table>"


def _claim(index: int, claim: Claim) -> str:
    said = f'<br><span class="soft">{escape(claim.explanation)}</span>' if claim.explanation else ""
    measured = claim.measured if claim.unit == "1" else f"{claim.measured}, {claim.unit}"
    cells = (
        str(index), escape(claim.text) + said, escape(measured), escape(claim.bound),
        _figures(claim, "printed"), _figures(claim, "ours"),
        f'<b class="{escape(claim.verdict)}">{escape(claim.verdict)}</b>',
    )  # fmt: skip
    return f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"


def _figures(claim: Claim, side: str) -> str:
    if side not in claim.spread:
        return "see cost.json"
    middle, least, most = claim.spread[side]
    return f'{middle:.3g}<br><span class="soft">{least:.3g} to {most:.3g}, {claim.share[side]:.0%} hold</span>'


def _table(table: Table) -> str:
    def row(tag: str, cells: Sequence[str]) -> str:
        return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"

    body = "".join(row("td", cells) for cells in table.rows)
    return f"<table><caption>{escape(table.caption)}</caption>{row('th', table.head)}{body}</table>"


def _drawn(path: Path, title: str) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<p><img alt="{escape(title)}" src="data:image/png;base64,{data}"></p>'


def _figure(out: Path, title: str, make: Callable[[Path], None]) -> Path:
    """The figure as PNG, and beside it as SVG."""
    folder = out / "figures"
    folder.mkdir(exist_ok=True)
    path = folder / f"{title.replace(', ', '-').replace(' ', '-')}.png"
    for suffix in (".svg", ".png"):
        make(path.with_suffix(suffix))
    return path


def _json(value: Any) -> str:
    """JSON, with null for what is not a finite number."""
    return json.dumps(jsonable(value), indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def _save(path: Path, text: str) -> None:
    with files.replacing(path) as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")

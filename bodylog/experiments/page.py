"""The page: every claim with its verdict and figures, the paper's figures redrawn, our answer beside."""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from html import escape
from pathlib import Path
from typing import Any

from .. import __version__, files
from . import draw
from .records import Claim, Table, Trial
from .table import EXPERIMENTS, TIMED

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #20262e; max-width: 68rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; width: 100%; margin: 1rem 0; font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: .35rem .6rem; border-bottom: 1px solid #e0e3e7; }
th { font-size: .85em; color: #59636e; } caption { text-align: left; font-weight: 600; }
.soft { color: #59636e; font-size: .9em; } img { max-width: 100%; }
.confirmed { color: #1a7f47; } .corrected { color: #a86400; } .refuted { color: #b3261e; }
"""


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
    """The page as text; figures are drawn beside it and taken in."""
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
    title = "The paper's experiments, reproduced"
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; "
        "style-src 'unsafe-inline'\">\n"
        f"<title>{title}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )


def _summary(claims: Mapping[str, Sequence[Claim]]) -> str:
    every = [claim for found in claims.values() for claim in found]
    counts = {verdict: sum(c.verdict == verdict for c in every) for verdict in ("confirmed", "corrected", "refuted")}
    told = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    return f"<p>{len(every)} claims: {told}.</p>"


def _section(name: str, trials: Sequence[Trial], claims: Sequence[Claim], out: Path) -> str:
    experiment = EXPERIMENTS[name]
    parts = [f'<h2 id="{escape(name)}">{escape(name)}: {escape(experiment.title)}</h2>', claim_table(claims)]
    if name in TIMED:
        parts.append('<p class="soft">Times differ from run to run and are kept in cost.json, beside this page.</p>')
        return "\n".join(parts)
    parts += [_table(table) for table in experiment.tables(trials)]
    if trials[0]["panels"]:
        parts.append(_drawn(out, f"{name}, first seed", lambda path: draw.traces(trials[0]["panels"], path)))
    parts.append(_drawn(out, f"{name}, all seeds", lambda path: draw.spreads(claims, path)))
    return "\n".join(parts)


def claim_table(claims: Sequence[Claim]) -> str:
    """Claims as rows: what was said, what was measured, medians with least and greatest, verdict."""
    head = ("", "claim", "measured", "must be", "printed model", "ours", "verdict")
    rows = "".join(_claim(index, claim) for index, claim in enumerate(claims, 1))
    return f"<table><tr>{''.join(f'<th>{h}</th>' for h in head)}</tr>{rows}</table>"


def _claim(index: int, claim: Claim) -> str:
    said = f'<br><span class="soft">{escape(claim.explanation)}</span>' if claim.explanation else ""
    cells = (
        str(index), escape(claim.text) + said, f"{escape(claim.measured)} ({escape(claim.unit)})", escape(claim.bound),
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


def _drawn(out: Path, title: str, make: Any) -> str:
    folder = out / "figures"
    folder.mkdir(exist_ok=True)
    path = folder / f"{title.replace(', ', '-').replace(' ', '-')}.png"
    make(path)
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<p><img alt="{escape(title)}" src="data:image/png;base64,{data}"></p>'


def _json(value: Any) -> str:
    """JSON, with null for what is not a finite number."""
    return json.dumps(_finite(value), indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not abs(value) < float("inf") else value


def _save(path: Path, text: str) -> None:
    with files.replacing(path) as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")

"""The text and tables of the page; all text from a log is escaped here."""

import html
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from math import isfinite
from typing import Any, NamedTuple

from ...io.values import read_json
from ...score_names import split
from ...types import Estimate, Fault, Features, Health, Recording, Score, Synchrony, Touch
from .traces import EVENTS, JOINTS, TRACKS

_ROWS, _WORD, _TEXT = 200, 200, 40_000
"""Most rows of a table, characters of a name, characters of a block of settings."""


class Moment(NamedTuple):
    """A table's cell that links to a time span (s) in the plots."""

    start: float
    end: float


def escaped(text: str, longest: int = _WORD) -> str:
    """Text from a log, escaped for a page: no tags, no control or direction characters, limited length."""
    clean = "".join(c if c.isprintable() or c == "\n" else "\ufffd" for c in text)
    return html.escape(clean if len(clean) <= longest else clean[: longest - 1] + "…")


def title(recording: Recording, provenance: Mapping[str, str]) -> str:
    """The name of the log that was estimated, and that of the annotated one if it differs: a batch's are all alike."""
    match _parsed(provenance.get("inputs", "")):
        case [[str(name), *_], *_] if name != recording.name:
            return f"{name} ({recording.name})"
    return recording.name


def header(
    title: str, recording: Recording, estimate: Estimate, verdict: Sequence[str], headline: Mapping[str, str]
) -> str:
    """Title, start, duration, method, the verdict's sentences, and the main figures as cards."""
    facts = [_when(recording.start_ns), f"{recording.duration_s:.2f} s", recording.format]
    facts += [f"method {estimate.method}", f"{len(estimate.joints.names)} joints"]
    line = escaped(" · ".join(facts))
    cards = "".join(f"<div><b>{escaped(value)}</b>{escaped(name)}</div>" for name, value in headline.items())
    shown = f'\n<div class="cards">{cards}</div>' if cards else ""
    text = "".join(f"\n<p>{escaped(sentence, _TEXT)}</p>" for sentence in verdict)
    return f'<h1>{escaped(title)}</h1>\n<p class="soft">{line}</p>{text}{shown}'


def score_tables(scores: Sequence[Score]) -> str:
    """The scores of the whole log; those named figure/part: one row per part, one column per figure."""
    whole = [(score.name, _quantity(score)) for score in scores if not split(score.name)[1]]
    tables = (table("Scores", ("score", "value"), whole), _parts(scores))
    return "\n".join(text for text in tables if text)


def _parts(scores: Sequence[Score]) -> str:
    found = {split(x.name): _quantity(x) for x in scores if split(x.name)[1]}
    figures = list(dict.fromkeys(figure for figure, _ in found))
    parts = dict.fromkeys(part for _, part in found)
    rows = [(part, *(found.get((figure, part), "–") for figure in figures)) for part in parts]
    return table("Scores in parts", ("part", *figures), rows)


def faults(estimate: Estimate) -> str:
    """The table of sensor faults: sense, name, kind, start, end, size."""
    rows = [
        (x.sense, x.name, x.kind, Moment(x.since, x.until or x.since), _until(x), _amount(x))
        for x in estimate.faults
    ]
    return table("Sensor faults", ("sense", "name", "kind", "since", "until", "size"), rows)


def _until(fault: Fault) -> str:
    return "–" if fault.until is None else f"{fault.until:.2f} s"


def notes(features: Features, estimate: Estimate) -> list[str]:
    """One line for everything drawn only in part."""
    counted = [
        (len(estimate.joints.names), JOINTS, "joints"),
        (len(features.tracks), TRACKS, "tracks"),
        (len(features.touches or ()), EVENTS, "touches"),
        (len(features.strokes), EVENTS, "strokes"),
    ]
    return [f"Drawn: the first {most} of {count} {what}." for count, most, what in counted if count > most]


def tables(recording: Recording, features: Features, estimate: Estimate) -> str:
    """Tables of findings, touches, health per topic and sense, and roles."""
    findings = (*recording.findings, *features.findings, *estimate.findings)
    parts = [
        table("Remarks", ("severity", "what"), [(x.severity, x.text) for x in findings]),
        _health("Health of the log, per topic", recording.health),
        _health("What perception found, per feature", features.health),
        _health("What the estimate used, per sense", estimate.used),
        _touches(features),
        table("Which topic is what", ("role", "topic"), list(recording.roles.items())),
    ]
    return "\n".join(part for part in parts if part)


def settings(estimate: Estimate, provenance: Mapping[str, str]) -> str:
    """Resolved settings and provenance, as text."""
    origin = {key: _parsed(value) for key, value in provenance.items()}
    shown = {"Settings": estimate.settings, "Provenance": origin}
    blocks = {title: escaped(_pretty(values), _TEXT) for title, values in shown.items() if values}
    return "\n".join(f"<h2>{title}</h2>\n<pre>{text}</pre>" for title, text in blocks.items())


def _health(title: str, health: Mapping[str, Health]) -> str:
    rows = [
        (name, f"{h.seen}", f"{h.used}", f"{h.largest_gap_s:.3f} s", _reasons(h.rejected)) for name, h in health.items()
    ]
    return table(title, ("name", "seen", "used", "largest gap", "rejected"), rows)


def _touches(features: Features) -> str:
    pairs = {pair.touch: pair for pair in features.synchrony}
    rows = [_touch(x, pairs.get(i)) for i, x in enumerate(features.touches or ())]
    return table("Touches", ("from", "lasting", "cells", "peak", "seen later by", "synchrony"), rows)


def _touch(touch: Touch, pair: Synchrony | None) -> tuple[str | Moment, ...]:
    seen = (f"{pair.delay:.3f} s", f"{pair.weight:.2f}") if pair and isfinite(pair.delay) else ("–", "–")
    cells = ", ".join(str(cell) for cell in touch.cells)
    return Moment(touch.onset, touch.offset), f"{touch.offset - touch.onset:.3f} s", cells, f"{touch.peak:.2f}", *seen


def _reasons(rejected: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in rejected.items()) or "–"


def table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str | Moment]]) -> str:
    """A table as HTML, "" without rows; at most `_ROWS` rows, the rest counted."""
    if not rows:
        return ""
    head = "".join(f"<th>{escaped(name)}</th>" for name in heads)
    body = "\n".join(f"<tr>{''.join(_cell(value) for value in row)}</tr>" for row in rows[:_ROWS])
    more = f'<p class="soft">and {len(rows) - _ROWS} more</p>' if len(rows) > _ROWS else ""
    return f'<h2>{escaped(title)}</h2>\n<div class="scroll"><table><tr>{head}</tr>\n{body}\n</table></div>{more}'


def _cell(value: str | Moment) -> str:
    if isinstance(value, Moment):
        margin = max(0.5, value.end - value.start)
        target = f"#t={value.start - margin:.3f},{value.end + margin:.3f}"
        return f'<td><a href="{target}">{value.start:.3f} s</a></td>' if isfinite(margin) else "<td>–</td>"
    mark = f' class="{value}"' if value in ("warning", "lost") else ""
    return f"<td{mark}>{escaped(value)}</td>"


def _quantity(score: Score) -> str:
    return f"{score.value:.4g}" if score.unit in ("", "1") else f"{score.value:.4g} {score.unit}"


def _amount(fault: Fault) -> str:
    sure = "" if fault.std is None else f" ± {fault.std:.2g}"
    return f"{fault.size:.4g}{sure} {fault.unit}".strip()


def _when(start_ns: int) -> str:
    try:
        return datetime.fromtimestamp(start_ns // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (ValueError, OverflowError, OSError):
        return f"start {start_ns} ns"  # a time outside the calendar


def _parsed(value: str) -> Any:
    try:
        return read_json(value)
    except ValueError:
        return value


def _pretty(value: Any) -> str:
    return json.dumps(value, indent=2, sort_keys=True, ensure_ascii=False, default=str)

"""The text and tables of the page; all text from a log is escaped here."""

import html
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from math import isfinite
from typing import Any, NamedTuple

from ...io.values import read_json
from ...score_names import split_score_name
from ...types import Estimate, Fault, Features, Health, Recording, Score, Synchrony, Touch
from .traces import EVENTS, JOINTS, TRACKS

_FIRST_DATE_NS = 31_536_000 * 10**9
"""A clock that reads less, until 1971, began at 0 and tells no date."""
_ROWS = 200
_WORD = 200
_TEXT = 40_000
"""Most rows of a table, characters of a name, characters of a block of settings."""


class TimeSpanLink(NamedTuple):
    """A table's cell that links to a time span (s) in the plots."""

    start: float
    end: float


def escape_text(text: str, longest: int = _WORD) -> str:
    """Text from a log, escaped for a page: no tags, no
    control or direction characters, limited length.
    """
    clean = "".join(c if c.isprintable() or c == "\n" else "\ufffd" for c in text)
    return html.escape(clean if len(clean) <= longest else clean[: longest - 1] + "…")


def page_title(recording: Recording, provenance: Mapping[str, str]) -> str:
    """The name of the log that was estimated, and that of
    the annotated one if it differs: a batch's are all alike.
    """
    match _parse_json_text(provenance.get("inputs", "")):
        case [[str(name), *_], *_] if name != recording.facts.name:
            return f"{name} ({recording.facts.name})"
    return recording.facts.name


def page_header(
    title: str,
    recording: Recording,
    estimate: Estimate,
    verdict: Sequence[str],
    headline: Mapping[str, str],
) -> str:
    """Title, start, duration, method, the verdict's sentences, and the main figures as cards."""
    lasting = f"{recording.duration_s:.2f} s"
    if recording.signals.poses:
        count = len(estimate.joints.t)
        lasting = f"{count} still poses, each independent of the others"
    dated = recording.start_ns >= _FIRST_DATE_NS
    facts = [
        *([_start_time_text(recording.start_ns)] if dated else []),
        lasting,
        recording.facts.format,
    ]
    facts += [f"method {estimate.method}", f"{len(estimate.joints.names)} joints"]
    line = escape_text(" · ".join(facts))
    cards = "".join(
        f"<div><b>{escape_text(value)}</b>{escape_text(name)}</div>"
        for name, value in headline.items()
    )
    shown = f'\n<div class="cards">{cards}</div>' if cards else ""
    text = "".join(f"\n<p>{escape_text(sentence, _TEXT)}</p>" for sentence in verdict)
    return f'<h1>{escape_text(title)}</h1>\n<p class="soft">{line}</p>{text}{shown}'


def score_tables(scores: Sequence[Score]) -> str:
    """The scores of the whole log; those named
    figure/part: one row per part, one column per figure.
    """
    whole = [
        (score.name, _score_text(score)) for score in scores if not split_score_name(score.name)[1]
    ]
    tables = (html_table("Scores", ("score", "value"), whole), _score_parts_table(scores))
    return "\n".join(text for text in tables if text)


def _score_parts_table(scores: Sequence[Score]) -> str:
    found = {
        split_score_name(x.name): _score_text(x) for x in scores if split_score_name(x.name)[1]
    }
    figures = list(dict.fromkeys(figure for figure, _ in found))
    parts = dict.fromkeys(part for _, part in found)
    rows = [(part, *(found.get((figure, part), "–") for figure in figures)) for part in parts]
    return html_table("Scores in parts", ("part", *figures), rows)


def fault_table(estimate: Estimate, still: bool = False) -> str:
    """The table of sensor faults: sense, name, kind, start, end, size; of still poses without
    start and end.
    """
    rows = [
        (
            x.sense,
            x.name,
            x.kind,
            TimeSpanLink(x.since, x.until or x.since),
            ("–" if x.until is None else f"{x.until:.2f} s"),
            _fault_size_text(x),
        )
        for x in estimate.faults
    ]
    heads = ["sense", "name", "kind", "since", "until", "size"]
    if still:
        return html_table("Sensor faults", heads[:3] + heads[5:], [x[:3] + x[5:] for x in rows])
    return html_table("Sensor faults", heads, rows)


def list_thinning_notes(features: Features, estimate: Estimate) -> list[str]:
    """One line for everything drawn only in part."""
    counted = [
        (len(estimate.joints.names), JOINTS, "joints"),
        (len(features.tracks), TRACKS, "tracks"),
        (len(features.touches or ()), EVENTS, "touches"),
        (len(features.strokes), EVENTS, "strokes"),
    ]
    return [
        f"Drawn: the first {most} of {count} {what}."
        for count, most, what in counted
        if count > most
    ]


def finding_tables(recording: Recording, features: Features, estimate: Estimate) -> str:
    """Tables of findings, touches, health per topic and sense, and roles."""
    findings = (*recording.facts.findings, *features.findings, *estimate.findings)
    parts = [
        html_table("Remarks", ("severity", "what"), [(x.severity, x.text) for x in findings]),
        _health_table("Health of the log, per topic", recording.facts.health),
        _health_table("What perception found, per feature", features.health),
        _health_table("What the estimate used, per sense", estimate.used),
        _touch_table(features),
        html_table("Which topic is what", ("role", "topic"), list(recording.facts.roles.items())),
    ]
    return "\n".join(part for part in parts if part)


def settings_section(estimate: Estimate, provenance: Mapping[str, str]) -> str:
    """Resolved settings and provenance, as text."""
    origin = {key: _parse_json_text(value) for key, value in provenance.items()}
    shown = {"Settings": estimate.settings, "Provenance": origin}
    blocks = {
        title: escape_text(_pretty_json(values), _TEXT) for title, values in shown.items() if values
    }
    return "\n".join(f"<h2>{title}</h2>\n<pre>{text}</pre>" for title, text in blocks.items())


def _health_table(title: str, health: Mapping[str, Health]) -> str:
    rows = [
        (name, f"{h.seen}", f"{h.used}", f"{h.largest_gap_s:.3f} s", _rejection_text(h.rejected))
        for name, h in health.items()
    ]
    return html_table(title, ("name", "seen", "used", "largest gap", "rejected"), rows)


def _touch_table(features: Features) -> str:
    pairs = {pair.touch: pair for pair in features.synchrony}
    rows = [_touch_row(x, pairs.get(i)) for i, x in enumerate(features.touches or ())]
    return html_table(
        "Touches", ("from", "lasting", "cells", "peak", "seen later by", "synchrony"), rows
    )


def _touch_row(touch: Touch, pair: Synchrony | None) -> tuple[str | TimeSpanLink, ...]:
    seen = (
        (f"{pair.delay:.3f} s", f"{pair.weight:.2f}")
        if pair and isfinite(pair.delay)
        else ("–", "–")
    )
    cells = ", ".join(str(cell) for cell in touch.cells)
    return (
        TimeSpanLink(touch.onset, touch.offset),
        f"{touch.offset - touch.onset:.3f} s",
        cells,
        f"{touch.peak:.2f}",
        *seen,
    )


def _rejection_text(rejected: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in rejected.items()) or "–"


def html_table(
    title: str, heads: Sequence[str], rows: Sequence[Sequence[str | TimeSpanLink]]
) -> str:
    """A table as HTML, "" without rows; at most `_ROWS` rows, the rest counted."""
    if not rows:
        return ""
    head = "".join(f"<th>{escape_text(name)}</th>" for name in heads)
    body = "\n".join(
        f"<tr>{''.join(_html_cell(value) for value in row)}</tr>" for row in rows[:_ROWS]
    )
    more = f'<p class="soft">and {len(rows) - _ROWS} more</p>' if len(rows) > _ROWS else ""
    return (
        f"<h2>{escape_text(title)}</h2>\n<div "
        f'class="scroll"><table><tr>{head}</tr>\n{body}\n</table></div>{more}'
    )


def _html_cell(value: str | TimeSpanLink) -> str:
    if isinstance(value, TimeSpanLink):
        margin = max(0.5, value.end - value.start)
        target = f"#t={value.start - margin:.3f},{value.end + margin:.3f}"
        return (
            f'<td><a href="{target}">{value.start:.3f} s</a></td>'
            if isfinite(margin)
            else "<td>–</td>"
        )
    mark = f' class="{value}"' if value in ("warning", "lost") else ""
    return f"<td{mark}>{escape_text(value)}</td>"


def _score_text(score: Score) -> str:
    return f"{score.value:.4g}" if score.unit in ("", "1") else f"{score.value:.4g} {score.unit}"


def _fault_size_text(fault: Fault) -> str:
    sure = "" if fault.std is None else f" ± {fault.std:.2g}"
    return f"{fault.size:.4g}{sure} {fault.unit}".strip()


def _start_time_text(start_ns: int) -> str:
    try:
        return datetime.fromtimestamp(start_ns // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (ValueError, OverflowError, OSError):
        return f"start {start_ns} ns"  # a time outside the calendar


def _parse_json_text(value: str) -> Any:
    try:
        return read_json(value)
    except ValueError:
        return value


def _pretty_json(value: Any) -> str:
    return json.dumps(value, indent=2, sort_keys=True, ensure_ascii=False, default=str)

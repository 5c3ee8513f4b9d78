"""The page about a dataset: verdict, episodes that stand out with their pictures, and small
multiples."""

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from typing import Any

from ...wording import list_in_words
from .tables import escape_text, html_table
from .template import render_document

MAX_WORST_EPISODES = 6
"""Episodes whose pictures are shown."""
_WIDTH = 220
_HEIGHT = 90
"""Size of a small multiple, px."""
_MOST_JOINTS = 60
_FIGURES = (
    "delay",
    "std",
    "repeated",
    "rate",
    "dropped",
    "frozen",
    "black",
    "idle",
    "duration",
    "error",
)
"""Figures in the table of episodes; the rest is in --csv."""
_SVG = '<svg viewBox="0 0 {w} {h}" width="{w}" height="{h}" role="img" aria-label="{label}">'


def dataset_page(
    rows: Sequence[Mapping[str, Any]],
    evidence: Mapping[str, Mapping[str, Any]],
    verdict: Sequence[str],
    outliers: Sequence[tuple[str, str]],
) -> str:
    """The page as text, without script and network: the same bytes for the same rows.

    evidence {row's name: as dataset.examination.evidence} · outliers: (name, sentence), the
    farthest first.
    """
    odd = list(dict.fromkeys(name for name, _ in outliers))
    parts = [
        f"<h1>{len(rows)} episodes</h1>",
        *(f"<p>{escape_text(sentence, 1000)}</p>" for sentence in verdict),
        html_table("Episodes that stand out", ("episode", "what"), outliers),
        _picture_strips(odd or _with_findings(rows), evidence),
        _camera_section(evidence, odd),
        _joint_section(evidence, odd),
        _episode_table(rows),
        html_table("Findings", ("episode", "severity", "what"), list(_collect_findings(rows))),
    ]
    return render_document("bodylog doctor", "\n".join(part for part in parts if part), [])


def _with_findings(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Names of the rows with most warnings first; the first rows where none has any."""
    counts = {
        row["name"]: sum(severity != "info" for severity, _ in row["findings"]) for row in rows
    }
    return sorted(counts, key=lambda name: -counts[name])


def _picture_strips(names: Sequence[str], evidence: Mapping[str, Mapping[str, Any]]) -> str:
    """A row of pictures for each camera of the worst episodes."""
    shown = []
    for name in names[:MAX_WORST_EPISODES]:
        for camera, about in evidence.get(name, {}).get("cameras", {}).items():
            pictures = "".join(
                f'<img alt="" src="data:image/jpeg;base64,{text}">' for text in about["thumbnails"]
            )
            if pictures:
                caption = escape_text(f"{name}, {camera}")
                shown.append(
                    f'<figure class="strip">{pictures}<figcaption>{caption}</figcaption></figure>'
                )
    return "<h2>Pictures</h2>\n" + "\n".join(shown) if shown else ""


def _camera_section(evidence: Mapping[str, Mapping[str, Any]], odd: Sequence[str]) -> str:
    """Delay, repeats and black images of each camera over episodes."""
    parts = []
    kinds = (
        ("delay", "s"),
        ("repeated", "share"),
        ("rate", "Hz"),
        ("black", "share"),
        ("frozen", "share"),
    )
    cameras = list(dict.fromkeys(name for one in evidence.values() for name in one["cameras"]))
    for camera in cameras:
        for kind, unit in kinds:
            figure = f"{kind}/{camera}"
            points = [
                (name, *one["figures"][figure][:2])
                for name, one in evidence.items()
                if figure in one["figures"]
            ]
            if points and (kind in ("delay", "rate") or any(value for _, value, _ in points)):
                parts.append(_dot_multiple(f"{figure} [{unit}]", points, list(evidence), odd))
    return (
        '<h2>Cameras over episodes</h2>\n<div class="multiples">' + "".join(parts) + "</div>"
        if parts
        else ""
    )


def _joint_section(evidence: Mapping[str, Mapping[str, Any]], odd: Sequence[str]) -> str:
    """Each joint's curve in every episode, over the share of its time; episodes that stand out are
    red."""
    curves: dict[str, list[tuple[str, list[float | None]]]] = {}
    for name, one in evidence.items():
        joints = one["joints"]
        for joint, curve in zip(joints["names"], joints["curves"], strict=True) if joints else ():
            curves.setdefault(joint, []).append((name, curve))
    parts = [
        _curve_multiple(joint, found, odd) for joint, found in list(curves.items())[:_MOST_JOINTS]
    ]
    more = (
        f'<p class="soft">and {len(curves) - _MOST_JOINTS} more joints</p>'
        if len(curves) > _MOST_JOINTS
        else ""
    )
    note = '<p class="soft">A line is an episode, from start to end; red: it stands out.</p>'
    return (
        f'<h2>Joints</h2>\n{note}<div class="multiples">' + "".join(parts) + "</div>" + more
        if parts
        else ""
    )


def _dot_multiple(
    title: str,
    points: Sequence[tuple[str, float, float | None]],
    names: Sequence[str],
    odd: Sequence[str],
) -> str:
    """One value per episode with its 2σ bar."""
    low = min(value - 2.0 * (std or 0.0) for _, value, std in points)
    high = max(value + 2.0 * (std or 0.0) for _, value, std in points)
    marks = []
    for name, value, std in points:
        x = _WIDTH * (names.index(name) + 0.5) / len(names)
        ink = _episode_ink(name, odd)
        y = _y_position(value, low, high)
        if std:
            ends = (
                _y_position(value - 2.0 * std, low, high),
                _y_position(value + 2.0 * std, low, high),
            )
            marks.append(f'<path d="M{x:.1f} {ends[0]:.1f}V{ends[1]:.1f}" stroke="{ink}"/>')
        marks.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.2" fill="{ink}">'
            f"<title>{escape_text(name)}</title></circle>"
        )
    return _small_multiple(title, low, high, marks)


def _curve_multiple(
    title: str, curves: Sequence[tuple[str, list[float | None]]], odd: Sequence[str]
) -> str:
    known = [value for _, curve in curves for value in curve if value is not None]
    if not known:
        return ""
    low = min(known)
    high = max(known)
    # episodes that stand out are drawn last, above the others
    ordered = sorted(curves, key=lambda pair: pair[0] in odd)
    paths = [
        f'<path d="{_curve_path(curve, low, high)}" fill="none" stroke="{_episode_ink(name, odd)}" '
        f'stroke-opacity="{1 if name in odd else 0.5}"><title>{escape_text(name)}</title></path>'
        for name, curve in ordered
    ]
    return _small_multiple(title, low, high, paths)


def _curve_path(curve: Sequence[float | None], low: float, high: float) -> str:
    """The points of a curve as an SVG path with gaps."""
    text = []
    drawing = False
    for number, value in enumerate(curve):
        if value is None or not isfinite(value):
            drawing = False
            continue
        x = _WIDTH * number / max(len(curve) - 1, 1)
        text.append(f"{'L' if drawing else 'M'}{x:.1f} {_y_position(value, low, high):.1f}")
        drawing = True
    return "".join(text)


def _y_position(value: float, low: float, high: float) -> float:
    span = high - low
    share = 0.5 if span <= 0.0 else (value - low) / span
    return 4.0 + (_HEIGHT - 8.0) * (1.0 - share)


def _episode_ink(name: str, odd: Sequence[str]) -> str:
    return "var(--fault)" if name in odd else "var(--c0)"


def _small_multiple(title: str, low: float, high: float, marks: Sequence[str]) -> str:
    head = _SVG.format(w=_WIDTH, h=_HEIGHT, label=escape_text(title))
    caption = f"{escape_text(title)}<br><span>{low:.3g} to {high:.3g}</span>"
    return f"<figure>{head}{''.join(marks)}</svg><figcaption>{caption}</figcaption></figure>"


def _episode_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """A row for each episode with the figures of cameras and of the whole."""
    figures = sorted(
        {name for row in rows for name in row["scores"] if name.partition("/")[0] in _FIGURES}
    )
    shown = [
        (
            row["name"],
            row["status"],
            *(_format_figure(row["scores"].get(figure)) for figure in figures),
            str((row["error"] or "").strip().splitlines()[-1:][0] if row["error"] else ""),
        )
        for row in rows
    ]
    return html_table("Episodes", ("episode", "status", *figures, "remark"), shown)


def _format_figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def _collect_findings(rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str, str]]:
    """Losses and warnings, then what is worth knowing; what several episodes say alike stands
    once."""
    found: dict[tuple[str, str], dict[str, None]] = {}
    for row in rows:
        for severity, text in row["findings"]:
            sentence = text.removeprefix(f"{row['log']}: ")
            found.setdefault((severity, sentence), {})[row["name"]] = None
    for wanted in ("lost", "warning", "info"):
        for (severity, text), names in found.items():
            if severity == wanted:
                count = f"{len(names)}: " if len(names) > 1 else ""
                yield count + list_in_words(list(names)), severity, text

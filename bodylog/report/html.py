"""The report: one self-contained HTML page about one log, its estimate and how far to trust it."""

import base64
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..files import replacing
from ..types import Estimate, Features, Recording, Score
from .overlay import Picture
from .packing import embedded, marks, most_points, plain
from .sections import escaped, faults, header, notes, score_table, settings, tables
from .traces import panels

_ASSETS = Path(__file__).parent / "assets"
_QUALITY = 82
_POLICY = "default-src 'none'; img-src data:; base-uri 'none'; form-action 'none'; style-src {}; script-src {}"


def write(
    out: Path,
    estimate: Estimate | None,
    features: Features | None,
    recording: Recording,
    scores: Sequence[Score] = (),
    pictures: Sequence[Picture] = (),
    provenance: Mapping[str, str] | None = None,
) -> None:
    """Write the page to `out`, whole or not at all: no network, the same bytes for the same input."""
    drawn = panels(recording, features, estimate)
    data = embedded(plain(drawn, marks(features, estimate), recording.duration_s))
    body = [
        header(recording, estimate, scores),
        faults(estimate),
        _plots(most_points(drawn), notes(features, estimate)) if drawn else "",
        _gallery(pictures),
        score_table(scores),
        tables(recording, features, estimate),
        settings(estimate, provenance or {}),
        f'<script type="application/json" id="data">{data}</script>' if drawn else "",
    ]
    page = _page(recording.name, "\n".join(part for part in body if part), scripted=bool(drawn))
    with replacing(out) as beside:
        beside.write_text(page, encoding="utf-8", newline="\n")


def _page(title: str, body: str, scripted: bool) -> str:
    style = _asset("page.css")
    script = _asset("panel.js") + _asset("view.js") if scripted else ""
    policy = _POLICY.format(_source(style), _source(script))
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escaped(title)}</title>\n<style>{style}</style>\n</head>\n<body>\n{body}\n"
        + (f"<script>{script}</script>\n" if script else "")
        + "</body>\n</html>\n"
    )


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")


def _source(text: str) -> str:
    """The one inline text the browser may use: nothing a log says can run."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _plots(points: int, remarks: Sequence[str]) -> str:
    said = "".join(f"<p>{escaped(remark)}</p>" for remark in remarks)
    return (
        '<h2>Over time</h2>\n<div class="bar"><button id="all" type="button">whole log</button>'
        '<output id="shown"></output><span class="soft">drag: zoom · shift-drag, <kbd>←</kbd> <kbd>→</kbd>: move · '
        "ctrl-wheel, <kbd>+</kbd> <kbd>-</kbd>: zoom · double click, <kbd>0</kbd>: whole log</span></div>\n"
        '<noscript><p class="warning">The plots need JavaScript; the tables below do not.</p></noscript>\n'
        '<div class="panels" id="panels"></div>\n<div class="soft">'
        "<p>Ground orange: touch felt, violet: stroke seen; red line: a fault begins. "
        f"Lines keep at most {points} points: the lowest and highest of every stretch and its gaps; "
        f"bands are never narrower than the whole ones.</p>{said}</div>"
    )


def _gallery(pictures: Sequence[Picture]) -> str:
    if not pictures:
        return ""
    shown = "\n".join(
        f'<figure><img alt="the camera at {picture.t:.2f} s" src="data:image/jpeg;base64,{_jpeg(picture)}">'
        f"<figcaption>{escaped(picture.caption)}</figcaption></figure>"
        for picture in pictures
    )
    key = "yellow ring: seen · blue cross and ellipse: predicted, 2σ · white square: hand"
    return f'<h2>Pictures</h2>\n<p class="soft">{key}</p>\n<div class="pictures">\n{shown}\n</div>'


def _jpeg(picture: Picture) -> str:
    import cv2

    done = cv2.imencode(".jpg", picture.image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return base64.b64encode(done.tobytes()).decode()

"""The report: one self-contained HTML page about one log, its estimate and its reliability."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from ...io.atomic_files import replacing
from ...types import Estimate, Features, Recording, Score
from ..figures import reprojection
from ..viewers.image_overlay import Picture
from .data import marks, most_points, plain
from .tables import escaped, faults, header, notes, score_tables, settings, tables, title
from .template import document, plots
from .traces import panels

_QUALITY = 82


def write(
    out: Path,
    estimate: Estimate,
    features: Features,
    recording: Recording,
    scores: Sequence[Score],
    pictures: Sequence[Picture],
    provenance: Mapping[str, str],
    verdict: Sequence[str] = (),
    headline: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Write the page to `out`, atomically: no network, the same bytes for the same input.

    verdict: sentences at the top · headline: the main figures by name, each a card.
    """
    drawn = panels(recording, features, estimate)
    groups = [plain(drawn, marks(features, estimate), recording.duration_s)] if drawn else []
    zeros = reprojection.zeros(estimate.settings.get("offsets"))
    name = title(recording, provenance)
    body = [
        header(name, recording, estimate, verdict, headline),
        faults(estimate),
        _plots(most_points(drawn), notes(features, estimate)) if drawn else "",
        _gallery(pictures, features.hand is not None),
        reprojection.section(reprojection.sheets(features, estimate), zeros),
        score_tables(scores),
        tables(recording, features, estimate),
        settings(estimate, provenance),
    ]
    page = document(name, "\n".join(part for part in body if part), groups)
    with replacing(out) as beside:
        beside.write_text(page, encoding="utf-8", newline="\n")


def _plots(points: int, lines: Sequence[str]) -> str:
    marked = "Ground orange: touch felt, violet: stroke seen; red line: a fault begins. "
    kept = f"Lines keep at most {points} points: the lowest and highest of every stretch and its gaps; "
    return "<h2>Over time</h2>\n" + plots((f"{marked}{kept}bands are never narrower than the whole ones.", *lines))


def _gallery(pictures: Sequence[Picture], hand: bool) -> str:
    if not pictures:
        return ""
    shown = "\n".join(
        f'<figure><img alt="the camera at {picture.t:.2f} s" src="data:image/jpeg;base64,{_jpeg(picture)}">'
        f"<figcaption>{escaped(picture.caption)}</figcaption></figure>"
        for picture in pictures
    )
    key = "green ring: measured · yellow cross and ellipse: predicted, 2σ" + " · red square: hand" * hand
    return f'<h2>Pictures</h2>\n<p class="soft">{key}</p>\n<div class="pictures">\n{shown}\n</div>'


def _jpeg(picture: Picture) -> str:
    import cv2

    done = cv2.imencode(".jpg", picture.image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return base64.b64encode(done.tobytes()).decode()

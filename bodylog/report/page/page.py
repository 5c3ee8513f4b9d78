"""The report: one self-contained HTML page about one log, its estimate and its reliability."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from ...io.atomic_files import replace_atomically
from ...types import Estimate, Features, Recording, Score
from ..figures import reprojection, surface_sheet
from ..viewers.image_overlay import OverlayPicture
from .data import background_marks, most_points, panels_as_json
from .tables import (
    escape_text,
    fault_table,
    finding_tables,
    list_thinning_notes,
    page_header,
    page_title,
    score_tables,
    settings_section,
)
from .template import plots_placeholder, render_document
from .traces import list_panels

_QUALITY = 82


def write_report_page(
    out: Path,
    estimate: Estimate,
    features: Features,
    recording: Recording,
    scores: Sequence[Score],
    pictures: Sequence[OverlayPicture],
    provenance: Mapping[str, str],
    verdict: Sequence[str] = (),
    headline: Mapping[str, str] = MappingProxyType({}),
    surface: Sequence[OverlayPicture] = (),
) -> None:
    """Write the page to `out`, atomically: no network, the same bytes for the same input.

    verdict: sentences at the top · headline: the main figures by name, each a card · surface:
    pictures of the robot's own surface.
    """
    drawn = list_panels(recording, features, estimate)
    groups = (
        [panels_as_json(drawn, background_marks(features, estimate), recording.duration_s)]
        if drawn
        else []
    )
    zeros = reprojection.parse_zeros(estimate.settings.get("offsets"))
    name = page_title(recording, provenance)
    body = [
        page_header(name, recording, estimate, verdict, headline),
        fault_table(estimate),
        _plots_section(most_points(drawn), list_thinning_notes(features, estimate))
        if drawn
        else "",
        surface_sheet.surface_section([_picture_figure(one) for one in surface], estimate),
        _picture_gallery(pictures, features.hand is not None),
        reprojection.render_section(reprojection.build_sheets(features, estimate), zeros),
        score_tables(scores),
        finding_tables(recording, features, estimate),
        settings_section(estimate, provenance),
    ]
    page = render_document(name, "\n".join(part for part in body if part), groups)
    with replace_atomically(out) as beside:
        beside.write_text(page, encoding="utf-8", newline="\n")


def _plots_section(points: int, lines: Sequence[str]) -> str:
    marked = "Ground orange: touch felt, violet: stroke seen; red line: a fault begins. "
    kept = (
        f"Lines keep at most {points} points: the lowest and highest of every stretch and its "
        "gaps; "
    )
    return "<h2>Over time</h2>\n" + plots_placeholder(
        (f"{marked}{kept}bands are never narrower than the whole ones.", *lines)
    )


def _picture_gallery(pictures: Sequence[OverlayPicture], hand: bool) -> str:
    if not pictures:
        return ""
    shown = "\n".join(_picture_figure(picture) for picture in pictures)
    key = (
        "green ring: measured · yellow cross and ellipse: predicted, 2σ"
        + " · red square: hand" * hand
    )
    return f'<h2>Pictures</h2>\n<p class="soft">{key}</p>\n<div class="pictures">\n{shown}\n</div>'


def _picture_figure(picture: OverlayPicture) -> str:
    return (
        f'<figure><img alt="the camera at {picture.t:.2f} s" '
        f'src="data:image/jpeg;base64,{_picture_as_jpeg(picture)}">'
        f"<figcaption>{escape_text(picture.caption)}</figcaption></figure>"
    )


def _picture_as_jpeg(picture: OverlayPicture) -> str:
    import cv2

    done = cv2.imencode(".jpg", picture.image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return base64.b64encode(done.tobytes()).decode()

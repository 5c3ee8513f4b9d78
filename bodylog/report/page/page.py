"""The report: one self-contained HTML page about one log, its estimate and its reliability."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from ...io.atomic_files import write_text_atomically
from ...types import Estimate, Features, Recording, Score
from ..figures import reprojection, surface_sheet
from ..viewers.image_overlay import MOST_POSES, OverlayPicture
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
    sheets: Sequence[reprojection.ReprojectionSheet] = (),
) -> None:
    """Write the page to `out`, atomically: no network, the same bytes for the same input.

    verdict: sentences at the top · headline: the main figures by name, each a card · surface:
    pictures of the robot's own surface · sheets: residuals of boards and markers.

    Of still poses t is the pose's number.
    """
    still = recording.signals.poses
    drawn = list_panels(recording, features, estimate)
    marks = [] if still else background_marks(features, estimate)
    groups = (
        [panels_as_json(drawn, marks, recording.duration_s, "" if still else "s")] if drawn else []
    )
    notes = list_thinning_notes(features, estimate)
    zeros = reprojection.parse_zeros(estimate.settings.get("offsets"))
    name = page_title(recording, provenance)
    body = [
        page_header(name, recording, estimate, verdict, headline),
        fault_table(estimate, still),
        "" if still or not drawn else _plots_section(most_points(drawn), notes),
        surface_sheet.surface_section([_picture_figure(one) for one in surface], estimate),
        _picture_gallery(pictures, features.hand is not None, sheets if still else ()),
        reprojection.render_section(sheets, zeros),
        _plots_section(most_points(drawn), notes, "Pose by pose") if still and drawn else "",
        score_tables(scores),
        finding_tables(recording, features, estimate),
        settings_section(estimate, provenance),
    ]
    page = render_document(name, "\n".join(part for part in body if part), groups)
    write_text_atomically(out, page)


def _plots_section(points: int, lines: Sequence[str], title: str = "Over time") -> str:
    marked = "Ground orange: touch felt, violet: stroke seen; red line: a fault begins. "
    kept = (
        f"Lines keep at most {points} points: the lowest and highest of every stretch and its "
        "gaps; "
    )
    return f"<h2>{title}</h2>\n" + plots_placeholder(
        (f"{marked}{kept}bands are never narrower than the whole ones.", *lines)
    )


def _picture_gallery(
    pictures: Sequence[OverlayPicture], hand: bool, sheets: Sequence[reprojection.ReprojectionSheet]
) -> str:
    """The pictures with their key; with sheets those of still poses."""
    if not pictures:
        return ""
    shown = "\n".join(_picture_figure(picture) for picture in pictures)
    key = (
        "green ring: measured · yellow cross and ellipse: predicted, 2σ"
        + " · red square: hand" * hand
    )
    if sheets:
        times = min(sheet.magnified for sheet in sheets)
        key = (
            f"green dot: measured · yellow arrow: to where the calibration alone expects it, "
            f"{times:g} × as long as it is"
        )
        if len(pictures) == MOST_POSES:
            key += f"; the {MOST_POSES} images with the largest errors"
    return f'<h2>Pictures</h2>\n<p class="soft">{key}</p>\n<div class="pictures">\n{shown}\n</div>'


def _picture_figure(picture: OverlayPicture) -> str:
    return (
        f'<figure><img alt="{escape_text(picture.caption)}" '
        f'src="data:image/jpeg;base64,{_picture_as_jpeg(picture)}">'
        f"<figcaption>{escape_text(picture.caption)}</figcaption></figure>"
    )


def _picture_as_jpeg(picture: OverlayPicture) -> str:
    import cv2

    done = cv2.imencode(".jpg", picture.image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return base64.b64encode(done.tobytes()).decode()

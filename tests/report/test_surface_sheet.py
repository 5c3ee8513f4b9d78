"""The robot's own surface over images: marks where they belong, words beside them, no damage by a hostile log."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.report.figures.surface_sheet import (
    WIDTH,
    SurfaceView,
    draw_surface,
    link_colour,
    surface_pictures,
    surface_section,
)
from bodylog.report.page.page import write_report_page
from bodylog.types import SURFACE_VIEWS

from .records import estimate, features, recording

GREY = np.full((240, 320, 3), 128, np.uint8)
NONE = np.zeros((0, 4))


def marked(image):
    """v, u of every pixel that is no longer grey."""
    return np.argwhere((image != 128).any(axis=2))


def view_of_log(t, **changes):
    whole = {"t": t, "bones": [[10.0, 20.0, 60.0, 90.0]], "corners": [[100.0, 80.0, 101.0, 80.0, 1]]}
    return whole | changes


def judged(images, foreign=0.25, links=("base", "<b>upper</b>")):
    found = estimate()
    views = {"camera": {"foreign": foreign, "links": list(links), "images": images}}
    return replace(found, settings={**found.settings, SURFACE_VIEWS: views})


def test_ring_is_where_a_corner_is_measured_and_cross_where_it_is_predicted():
    corners = np.array([[100.0, 80.0, 200.0, 150.0, 2]])
    drawn = draw_surface(GREY, SurfaceView(0.0, NONE, corners))
    scale = WIDTH / 320
    found = marked(drawn)[:, ::-1] / scale
    for place in (corners[0, :2], corners[0, 2:4]):
        near = found[np.linalg.norm(found - place, axis=1) < 10.0]
        assert (near.min(axis=0) + near.max(axis=0)) / 2 == pytest.approx(place, abs=0.7)
    assert (drawn == link_colour(2)).all(axis=2).any()
    assert not (drawn == link_colour(3)).all(axis=2).any()


def test_bones_and_trails_join_their_ends_and_what_is_foreign_is_grey():
    trail = np.array([[40.0, 150.0], [240.0, 150.0]])
    view = SurfaceView(0.0, np.array([[50.0, 60.0, 250.0, 60.0]]), np.zeros((0, 5)), ((-1, trail),))
    drawn = draw_surface(GREY, view)
    scale = WIDTH / 320
    assert (drawn[round(60 * scale), round(150 * scale)] == 255).all()
    assert tuple(drawn[round(150 * scale), round(100 * scale)]) == link_colour(-1)


def test_page_shows_the_surface_its_error_and_the_share_of_foreign_corners(tmp_path):
    log = recording()
    t = next(iter(log.cameras.frames())).t
    found = judged([view_of_log(t)])
    pictures = surface_pictures(log, found)
    assert len(pictures) == 1 and "1 corners, 0.71 px off per axis" in pictures[0].caption
    out = tmp_path / "page.html"
    write_report_page(out, found, features(), log, (), (), {}, surface=pictures)
    page = out.read_text(encoding="utf-8")
    assert "25% of the moving corners are foreign" in page
    assert "&lt;b&gt;upper&lt;/b&gt;" in page and "<b>upper" not in page


@pytest.mark.parametrize(
    "images",
    [
        "none",
        [5, {"t": 1.0}],
        [{"t": "soon", "bones": [], "corners": []}],
        [{"t": float("nan"), "bones": [], "corners": []}],
        [view_of_log(0.0, bones=[[np.inf, 0.0, 0.0, 0.0]])],
        [view_of_log(0.0, corners=[[1e300, 0.0, 0.0, 0.0, 1]])],
        [view_of_log(0.0, corners=[[1.0, 2.0, 3.0]])],
        [view_of_log(0.0, corners=[[np.nan, 2.0, 3.0, 4.0, 1]])],
    ],
)
def test_damaged_views_are_left_out(images):
    found = judged(images, foreign="much")
    assert surface_pictures(recording(), found) == ()
    assert surface_section([], found) == ""

"""The reprojection sheet: what kinematics and the process leave of each track, and the joints' zeros."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.report.figures import figures, reprojection
from bodylog.report.figures.reprojection import (
    JointZero,
    ReprojectionSheet,
    build_sheets,
    parse_zeros,
    render_section,
)

from .records import estimate, features, series

TOLD = {
    "lift": {"value": 0.0349, "std": 0.0017, "unit": "rad", "confused_with": []},
    "rail": {"value": -0.002, "std": 0.0005, "unit": "m", "confused_with": []},
    "pan": {"value": None, "std": 0.08, "unit": "rad", "confused_with": ["camera's turn about the z axis of base"]},
}


def some(off=3.0):
    """A track of which kinematics alone is `off` px beside what is predicted."""
    seen, found = features(), estimate()
    predicted = found.predicted["effector"]
    alone = series(predicted.t, predicted.values + np.array([off, 0.0]), ("u", "v"), "px")
    return seen, replace(found, kinematic={"effector": alone})


def test_sheets_pair_measured_and_expected_points():
    seen, found = some()
    (sheet,) = build_sheets(seen, found)
    known = np.isfinite(seen.tracks["effector"].values).all(axis=1)
    np.testing.assert_array_equal(sheet.measured, seen.tracks["effector"].values[known])
    alone, both = sheet.errors
    assert both == pytest.approx(0.3 * np.sqrt(2), rel=0.1) and alone == pytest.approx(np.hypot(3.0, both), rel=0.02)
    assert sheet.magnified in (1, 2, 5, 10) and len(sheet.some().measured) == reprojection.POINTS


def test_sheets_omit_tracks_without_kinematics_or_sightings():
    seen, found = some()
    assert build_sheets(seen, estimate()) == () and build_sheets(replace(seen, tracks={}), found) == ()
    blind = replace(seen.tracks["effector"], values=np.full_like(seen.tracks["effector"].values, np.nan))
    assert build_sheets(replace(seen, tracks={"effector": blind}), found) == ()


def test_corners_of_a_board_share_a_sheet_on_the_plane_of_their_camera():
    seen, found = some()
    track = seen.tracks["effector"]
    seen = replace(seen, tracks={"left/board.0": track, "left/board.7": track})
    alone = found.kinematic["effector"]
    # the body has a sense for one of the corners alone
    found = replace(found, predicted={"left/board.0": found.predicted["effector"]})
    found = replace(found, kinematic={"left/board.0": alone, "left/board.7": alone})
    (sheet,) = build_sheets(seen, found, {"left": (640, 480)})
    known = np.isfinite(track.values).all(axis=1).sum()
    assert sheet.name == "left/board" and len(sheet.measured) == 2 * known
    assert np.isfinite(sheet.both).all(axis=1).sum() == known
    assert sheet.errors == pytest.approx(some_errors(), rel=1e-9)
    np.testing.assert_array_equal(sheet.limits, [[-0.5, -0.5], [639.5, 479.5]])
    assert "nan" not in render_section([sheet], ())


def some_errors():
    """Errors of the one track alone."""
    (sheet,) = build_sheets(*some())
    return sheet.errors


def test_zeros_show_their_std_or_why_they_are_not_identifiable():
    lift, rail, pan = parse_zeros(TOLD)
    assert lift.shown == ("+2.00° ± 0.10°", "+0.03490 ± 0.00170 rad")
    assert rail.shown[0] == "-2.00 mm ± 0.50 mm"
    assert pan.shown == ("not identifiable: camera's turn about the z axis of base", "")


@pytest.mark.parametrize("given", [None, 3, {"a": 1}, {"a": {"std": "x"}}, {"a": {"value": True, "std": 1.0}},
                                  {"a": {"value": float("nan"), "std": 1.0}}])  # fmt: skip
def test_zeros_leaves_out_invalid_entries(given):
    assert parse_zeros(given) == ()


def test_page_escapes_names_and_figures_are_drawn(tmp_path):
    name = "<b>$x_1$&"
    point = np.array([[0.0, 0.0], [5.0, 3.0]])
    drawn = [ReprojectionSheet(name, point, point + 1.0, point), ReprojectionSheet("still", point[:1], point[:1], point[:1])]
    text = render_section(drawn, [JointZero(name, None, 1.0, "rad", (name,))])
    assert "<b>" not in text and "&lt;b&gt;$x_1$&amp;" in text and text.count("<svg") == 2
    assert render_section((), ()) == ""
    figures.reprojection_figure(drawn, parse_zeros(TOLD), tmp_path / "a.png")
    figures.reprojection_figure(drawn, parse_zeros(TOLD), tmp_path / "b.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_section_draws_the_first_tracks_and_counts_the_rest():
    point = np.array([[0.0, 0.0], [5.0, 3.0]])
    many = [ReprojectionSheet(f"corner.{k}", point, point, point) for k in range(40)]
    text = render_section(many, ())
    assert text.count("<svg") == reprojection.TRACKS and "the first 12 of 40 boards" in text

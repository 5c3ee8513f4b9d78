import re

import numpy as np
import pytest

from bodylog.annotating.messages import draw_image_annotations
from bodylog.overlay_style import (
    CORNERS,
    MEASURED,
    OTHER,
    PREDICTED,
    ellipse_corners,
    measurement_ink,
)
from bodylog.report.page.template import render_document
from bodylog.report.viewers.image_overlay import draw_overlay
from tests.report.records import series

GREY = np.full((200, 300, 3), 128, np.uint8)
CENTRE = np.array([150.0, 100.0])


@pytest.mark.parametrize("seed", range(5))
def test_ellipses_have_corners_two_standard_deviations_from_the_centre(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(20, 2, 2))
    cov, centre = root @ root.transpose(0, 2, 1), rng.normal(size=(20, 2)) * 100
    off = ellipse_corners(centre, cov) - centre[:, None]
    assert off.shape == (20, CORNERS, 2)
    assert np.allclose(np.einsum("kpi,kij,kpj->kp", off, np.linalg.inv(cov), off), 4.0)
    around = np.linalg.norm(np.roll(off, -1, axis=1) + np.roll(off, CORNERS // 2 - 1, axis=1), axis=2)
    assert np.allclose(around, 0.0), "opposite corners mirror each other"


def test_ellipses_of_negative_variances_are_not_finite():
    assert not np.isfinite(ellipse_corners(CENTRE[None], -np.eye(2)[None])).all()


def test_measured_uses_the_part_behind_the_camera():
    assert measurement_ink("left/hand") == MEASURED["hand"] != measurement_ink("hand/left") == OTHER


@pytest.mark.parametrize(
    ("mark", "ink"), [("seen", measurement_ink("effector")), ("predicted", PREDICTED), ("hand", measurement_ink("hand"))]
)
def test_page_and_annotations_share_their_colours(mark, ink):
    """Pixels of the page's images, and colours in the messages that Foxglove draws."""
    drawn = draw_overlay(GREY, cov=None, **({"seen": None, "predicted": None, "hand": None} | {mark: CENTRE}))
    assert (drawn == ink.rgb[::-1]).all(axis=2).any()
    track = series(np.array([0.0]), CENTRE[None], ("u", "v"), "px")
    tracks = {"hand" if mark == "hand" else "effector": track}
    seen, predicted = ({}, tracks) if mark == "predicted" else (tracks, {})
    _, payloads = draw_image_annotations(seen, predicted, {}, 0)
    assert np.array([*ink.image, 1.0]).tobytes() in bytes(payloads.data)


def test_page_takes_its_colours_from_the_table():
    style = re.search("<style>(.*?)</style>", render_document("", "", ()), re.DOTALL)[1]
    for name, ink in {"predicted": PREDICTED, "other": OTHER, **MEASURED}.items():
        assert f"--{name}:{ink.plot}" in style

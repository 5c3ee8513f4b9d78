from dataclasses import replace

import cv2
import numpy as np
import pytest

from bodylog.errors import FormatError, UsageError
from bodylog.report.viewers.image_overlay import draw_overlay, draw_pictures, overlay_sheet
from bodylog.types import LazyImage
from tests.changed_recordings import change_recording

from .records import estimate, features, recording

GREY = np.full((200, 300, 3), 128, np.uint8)
LOST = np.array([np.nan, np.nan])


def marked(image):
    """v, u of every pixel that is no longer grey."""
    return np.argwhere((image != 128).any(axis=2))


@pytest.mark.parametrize("place", [(100.0, 50.0), (220.4, 150.7), (30.0, 30.0)])
@pytest.mark.parametrize("which", ["seen", "predicted", "hand"])
def test_mark_is_centred_on_its_sighting(place, which):
    marks = {"seen": None, "predicted": None, "hand": None} | {which: np.array(place)}
    found = marked(draw_overlay(GREY, cov=None, **marks))
    assert (found.min(axis=0) + found.max(axis=0)) / 2 == pytest.approx(place[::-1], abs=0.6)


@pytest.mark.parametrize("turn", np.linspace(0, np.pi, 7))
def test_ellipse_is_two_sigma_along_its_axes(turn):
    axis = np.array([np.cos(turn), np.sin(turn)])
    across = np.array([-axis[1], axis[0]])
    cov = 25.0**2 * np.outer(axis, axis) + 12.0**2 * np.outer(across, across)
    centre = np.array([150.0, 100.0])
    off = marked(draw_overlay(GREY, None, centre, cov, None))[:, ::-1] - centre
    far = np.sqrt(np.einsum("ni,ij,nj->n", off, np.linalg.inv(cov), off))
    rim = far[far > 1]  # the cross is nearer
    assert rim.mean() == pytest.approx(2.0, abs=0.05)
    assert rim.min() > 1.6 and rim.max() < 2.4  # the line is 4 px wide


@pytest.mark.parametrize("cov", [np.full((2, 2), np.nan), np.diag([1e12, 1.0]), np.zeros((2, 2)), -np.eye(2)])
def test_marks_that_cannot_be_drawn_are_left_out(cov):
    assert len(marked(draw_overlay(GREY, LOST, np.array([1e30, 5.0]), cov, LOST))) == 0
    cross = marked(draw_overlay(GREY, None, np.array([150.0, 100.0]), cov, None))
    assert np.abs(cross - (100, 150)).max() <= 9


def test_overlay_does_not_change_the_input_image():
    image = GREY.copy()
    draw_overlay(image, np.array([50.0, 50.0]), None, None, None)
    assert (image == GREY).all()


def test_pictures_are_spread_over_the_log_and_say_what_was_seen():
    drawn = draw_pictures(recording(), features(), estimate(), 6)
    assert np.allclose([p.t for p in drawn], (np.arange(6) + 0.5) * 20 / 6, atol=0.04)
    assert all("px apart" in p.caption for p in drawn if not 6 < p.t < 8)
    hidden = draw_pictures(recording(), features(), estimate(), 20)
    assert any(p.caption.endswith("not seen") for p in hidden)


def test_pictures_are_empty_without_a_camera():
    assert draw_pictures(change_recording(recording(), frames=None), features(), estimate()) == ()


def test_damaged_image_is_replaced_by_the_next():
    def broken(k):
        raise FormatError("frame")

    good = recording()
    frames = [LazyImage(0.0, 0, broken), *good.cameras.frames()]
    frames[100:110] = [replace(f, decode=broken) for f in frames[100:110]]
    assert len(draw_pictures(change_recording(good, frames=lambda: iter(frames)), features(), estimate(), 6)) == 6


def test_sheet_is_one_png_with_identical_bytes(tmp_path):
    drawn = draw_pictures(recording(), features(), estimate(), 5)
    for name in ("a.png", "b.png"):
        overlay_sheet(drawn, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert cv2.imread(str(tmp_path / "a.png")).shape == (2 * (240 + 26) + 26, 960, 3)


def test_sheet_refuses_no_images_and_other_formats(tmp_path):
    with pytest.raises(UsageError, match="no images"):
        overlay_sheet((), tmp_path / "a.png")
    with pytest.raises(UsageError, match=r"type: .*a\.png"):
        overlay_sheet(draw_pictures(recording(), features(), estimate(), 1), tmp_path / "a.jpg")


def test_pictures_show_each_cameras_own_marks():
    log, seen = recording(), features()
    aside = replace(seen, tracks=seen.tracks | {"side/effector": seen.tracks["effector"]})
    drawn = draw_pictures(change_recording(log, views={"side": log.cameras.frames}), aside, estimate(), 3)
    assert [p.caption.split(" · ")[0] for p in drawn[3:]] == ["side"] * 3 and len(drawn) == 6
    assert "px apart" in drawn[0].caption and "px apart" not in drawn[3].caption  # nothing predicted for it
    assert drawn[3].caption.endswith(" · seen")

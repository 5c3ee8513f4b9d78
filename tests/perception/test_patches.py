"""Pictures of landmarks are found again to a part of a pixel, and not where two places look alike."""

import cv2
import numpy as np
import pytest

from bodylog.perception.surface.patches import cut_patch, match_templates, warp_patches
from bodylog.types import Array

PLACE = np.array([80.0, 60.0])


def texture(seed: int) -> Array:
    """A smooth random grey image (120,160)."""
    rng = np.random.default_rng(seed)
    rough = cv2.GaussianBlur(rng.standard_normal((120, 160)), (0, 0), 2.0)
    return np.clip(128.0 + 45.0 * rough / rough.std(), 0, 255).astype(np.uint8)


def seen_through(image: Array, linear: Array, shift: Array) -> Array:
    """The image as it looks after p ↦ linear (p − PLACE) + PLACE + shift."""
    whole = np.column_stack([linear, PLACE + shift - linear @ PLACE])
    return np.asarray(cv2.warpAffine(image, whole, (160, 120), flags=cv2.INTER_CUBIC))


@pytest.mark.parametrize("degrees", [0.0, 20.0, -40.0])
@pytest.mark.parametrize("scale", [0.9, 1.0, 1.3])
def test_turned_and_scaled_picture_is_found_to_a_part_of_a_pixel(degrees, scale):
    image = texture(5)
    patch = cut_patch(image, PLACE)
    assert patch is not None
    angle = np.radians(degrees)
    linear = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shift = np.array([3.4, -2.7])
    templates, fit = warp_patches(patch[None], linear[None])
    assert fit.all()
    found = match_templates(seen_through(image, linear, shift), templates, PLACE[None], 6)
    assert found.sure.all()
    np.testing.assert_allclose(found.uv[0], PLACE + shift, atol=0.3)


def test_place_that_looks_like_another_is_not_sure():
    image = np.tile(texture(6)[:, :12], (1, 14))[:, :160].copy()
    patch = cut_patch(image, PLACE)
    assert patch is not None
    templates, _ = warp_patches(patch[None], np.eye(2)[None])
    assert not match_templates(image, templates, PLACE[None], 14).sure.any()
    assert match_templates(image, templates, PLACE[None], 5).sure.all()


def test_other_picture_is_not_found():
    patch = cut_patch(texture(7), PLACE)
    assert patch is not None
    templates, _ = warp_patches(patch[None], np.eye(2)[None])
    found = match_templates(texture(8), templates, PLACE[None], 10)
    assert not found.sure.any()
    assert found.score.max() < 0.8


def test_picture_without_contrast_or_at_the_rim_is_none():
    assert cut_patch(np.full((120, 160), 90, np.uint8), PLACE) is None
    assert cut_patch(texture(9), np.array([5.0, 60.0])) is None


def test_view_from_too_near_or_far_makes_no_template():
    patch = cut_patch(texture(10), PLACE)
    assert patch is not None
    _, fit = warp_patches(np.stack([patch] * 3), np.stack([3.0 * np.eye(2), 0.3 * np.eye(2), np.zeros((2, 2))]))
    assert not fit.any()


def test_template_at_the_rim_is_not_looked_for():
    patch = cut_patch(texture(11), PLACE)
    assert patch is not None
    templates, _ = warp_patches(patch[None], np.eye(2)[None])
    found = match_templates(texture(11), templates, np.array([[4.0, 60.0]]), 6)
    assert found.score[0] == -1.0

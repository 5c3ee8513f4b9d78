import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bodylog.sim import camera as cameras

CAMERA = cameras.look_at(np.array([0.2, -1.1, 0.4]), np.zeros(3), (320, 240))
GREEN = np.array(cameras.GREEN)


def blank():
    return np.full((240, 320, 3), 60, np.uint8), np.full((240, 320), cameras.FAR)


def place(u, v, ahead):
    local = np.array([(u - 159.5) / CAMERA.focal, (v - 119.5) / CAMERA.focal, 1.0]) * ahead
    return CAMERA.position + CAMERA.rotation.T @ local


def test_camera_is_upright_and_looks_at_its_target():
    np.testing.assert_allclose(CAMERA.rotation @ CAMERA.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(CAMERA.rotation) == pytest.approx(1)
    np.testing.assert_allclose(cameras.ellipse_centre(CAMERA, np.zeros((1, 3)), 0.0), [[159.5, 119.5]], atol=1e-9)
    higher = cameras.ellipse_centre(CAMERA, np.array([[0.0, 0.0, 0.1]]), 0.0)[0]
    assert higher[1] < 119.5 and higher[0] == pytest.approx(159.5)


@settings(max_examples=20, deadline=None)
@given(st.floats(30, 290), st.floats(30, 210), st.floats(0.5, 1.5))
def test_truth_is_the_centroid_of_the_outline(u, v, ahead):
    centre, radius = place(u, v, ahead), 0.025
    rng = np.random.default_rng(0)
    # The outline by brute force: rays through a fine grid that meet the sphere.
    middle = np.array([u, v]) + rng.uniform(0, 0.05, 2)
    fine = np.stack(np.meshgrid(np.linspace(-25, 25, 401), np.linspace(-25, 25, 401)), -1) + middle
    ray = np.concatenate([(fine - [159.5, 119.5]) / CAMERA.focal, np.ones((401, 401, 1))], -1)
    local = CAMERA.rotation @ (centre - CAMERA.position)
    gap = np.linalg.norm(np.cross(ray, local), axis=-1) / np.linalg.norm(ray, axis=-1)
    outline = fine[gap < radius].mean(0)
    np.testing.assert_allclose(cameras.ellipse_centre(CAMERA, centre[None], radius)[0], outline, atol=0.02)


@pytest.mark.parametrize("seed", range(5))
def test_drawn_sphere_has_its_centroid_at_the_truth(seed):
    rng = np.random.default_rng(seed)
    errors = []
    for _ in range(20):
        centre = place(*rng.uniform([20, 20], [300, 220]), rng.uniform(0.7, 1.5))
        picture, depth = blank()
        share = cameras.draw_sphere(picture, depth, CAMERA, centre, 0.025, GREEN)
        assert share == pytest.approx(1.0, abs=0.02)
        weight = picture[..., 1].astype(float) - 60
        rows, columns = np.indices(weight.shape)
        seen = np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()
        errors.append(np.linalg.norm(seen - cameras.ellipse_centre(CAMERA, centre[None], 0.025)[0]))
    assert np.median(errors) < 0.02


def test_sphere_is_hidden_by_nearer_things():
    centre = place(100, 100, 1.0)
    picture, depth = blank()
    cameras.draw_card(picture, depth, (0, 0, 320, 240), 0.9)
    before = picture.copy()
    assert cameras.draw_sphere(picture, depth, CAMERA, centre, 0.025, GREEN) == 0.0
    np.testing.assert_array_equal(picture, before)
    picture, depth = blank()
    cameras.draw_card(picture, depth, (0, 0, 100, 240), 0.9)
    assert cameras.draw_sphere(picture, depth, CAMERA, centre, 0.025, GREEN) == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("u, v, low, high", [(0, 120, 0.4, 0.6), (-40, 120, 0.0, 0.0), (160, 400, 0.0, 0.0)])
def test_sphere_at_or_past_the_border(u, v, low, high):
    picture, depth = blank()
    assert low <= cameras.draw_sphere(picture, depth, CAMERA, place(u, v, 1.0), 0.025, GREEN) <= high


def test_sphere_behind_the_camera_is_not_drawn():
    picture, depth = blank()
    assert cameras.draw_sphere(picture, depth, CAMERA, place(160, 120, -1.0), 0.025, GREEN) == 0.0


def test_background_is_grey():
    wall = cameras.draw_background(CAMERA, np.random.default_rng(4)).astype(int)
    assert np.ptp(wall, axis=2).max() <= 6
    assert 30 < wall.mean() < 90


def test_noise_differs_between_pictures_and_has_two_grey_levels():
    rng = np.random.default_rng(1)
    noise = cameras.sensor_noise(CAMERA, rng)
    flat = np.full((240, 320, 3), 100, np.uint8)
    first, second = cameras.expose_image(flat, noise, rng).astype(float), cameras.expose_image(flat, noise, rng).astype(float)
    assert first.std() == pytest.approx(2.02, abs=0.03)
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.02

import numpy as np
import pytest

from bodylog.sim.camera import FAR, PinholeCamera
from bodylog.sim.tag import Plate

from .reading import tags

CAMERA = PinholeCamera(320, 240, 300.0, np.zeros(3), np.eye(3))


def turned(rng, most):
    """A rotation (3,3) by at most `most` rad about an axis by chance."""
    axis = rng.normal(size=3)
    x, y, z = axis / np.linalg.norm(axis) * rng.uniform(0.0, most)
    angle = np.linalg.norm([x, y, z])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) / angle
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def drawn(plate, depth=FAR, camera=CAMERA):
    picture = np.full((camera.height, camera.width, 3), 60, np.uint8)
    deep = np.full((camera.height, camera.width), depth)
    return picture, deep, plate.draw(picture, deep, camera)


def test_tag_is_drawn_at_its_centre():
    rng = np.random.default_rng(1)
    errors = []
    for number in range(80):
        place = np.array([rng.uniform(-0.2, 0.2), rng.uniform(-0.15, 0.15), rng.uniform(0.6, 0.8)])
        plate = Plate(place, turned(rng, 0.8), 0.12, number)
        picture, _, share = drawn(plate)
        assert share == pytest.approx(1.0, abs=0.02)
        if number in (found := tags(picture)):
            errors.append(found[number] - plate.pixel(CAMERA))
    assert len(errors) >= 72
    assert np.abs(np.mean(errors, axis=0)).max() < 0.03 and np.median(np.linalg.norm(errors, axis=1)) < 0.1


def test_tag_occlusion_follows_depth():
    plate = Plate(np.array([0.0, 0.0, 1.0]), np.eye(3), 0.2, 7)
    assert drawn(plate, depth=0.8)[2] == 0.0
    picture, depth, share = drawn(plate, depth=1.5)
    assert share == pytest.approx(1.0, abs=0.02) and 7 in tags(picture)
    assert Plate(np.array([0.0, 0.0, 1.2]), np.eye(3), 0.2, 3).draw(picture, depth, CAMERA) < 0.5
    assert 7 in tags(picture)


def test_tag_half_outside_the_image_is_half_visible():
    edge = 160.0 / 300.0
    assert drawn(Plate(np.array([edge, 0.0, 1.0]), np.eye(3), 0.2, 7))[2] == pytest.approx(0.5, abs=0.02)
    assert drawn(Plate(np.array([2 * edge, 0.0, 1.0]), np.eye(3), 0.2, 7))[2] == 0.0


def test_tag_is_invisible_from_behind_or_behind_the_camera():
    back = np.diag([-1.0, 1.0, -1.0])
    assert drawn(Plate(np.array([0.0, 0.0, 1.0]), back, 0.2, 7))[2] == 0.0
    assert drawn(Plate(np.array([0.0, 0.0, -1.0]), np.eye(3), 0.2, 7))[2] == 0.0

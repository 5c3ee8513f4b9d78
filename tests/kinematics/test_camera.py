"""Projection, rotations and a rig's predictions, against finite differences and each other."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bodylog.kinematics import rotations
from bodylog.kinematics.camera import lens_without_distortion, project_points
from bodylog.kinematics.instant import compile_predictor
from tests.kinematics import robots
from tests.kinematics.robots import board

STEP = 1e-6
VECTORS = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)


@given(VECTORS)
def test_logarithm_undoes_exponential(vector):
    size = np.linalg.norm(vector)
    vector = vector * min(1.0, 3.1 / max(size, 1e-9))
    rotation = rotations.rotation_from_vector(vector)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotations.vector_from_rotation(rotation), vector, atol=1e-6)
    np.testing.assert_allclose(rotations.rotation_from_rpy(rotations.rpy_from_rotation(rotation)), rotation, atol=1e-7)


@given(VECTORS)
def test_left_jacobian_is_the_slope_of_the_exponential(vector):
    slope = rotations.left_jacobian(vector)
    for k in range(3):
        step = STEP * np.eye(3)[k]
        both = rotations.rotation_from_vector(vector + step) @ rotations.rotation_from_vector(vector - step).T
        np.testing.assert_allclose(rotations.vector_from_rotation(both) / (2 * STEP), slope[:, k], atol=1e-6)


@given(VECTORS.filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_from_z_turns_z_into_the_axis(vector):
    axis = vector / np.linalg.norm(vector)
    turn = rotations.rotation_from_z(axis)
    np.testing.assert_allclose(turn[:, 2], axis, atol=1e-9)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)


def test_projection_is_a_pinholes_and_its_slopes_finite_differences():
    numbers = lens_without_distortion(600.0, 640, 480)
    image, _, _ = project_points(np.array([[0.1, -0.2, 2.0]]), numbers)
    np.testing.assert_allclose(image, [[320 + 30.0, 240 - 60.0]])
    numbers = numbers + np.array([0.01, 0.02, 3.0, -4.0, 0.1, -0.05])
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (7, 3)) + np.array([0.0, 0.0, 1.5])
    _, by_point, by_lens = project_points(points, numbers)
    for k in range(3):
        step = STEP * np.eye(3)[k]
        numeric = (project_points(points + step, numbers)[0] - project_points(points - step, numbers)[0]) / (2 * STEP)
        np.testing.assert_allclose(by_point[..., k], numeric, atol=1e-5)
    for k in range(6):
        step = STEP * np.eye(6)[k]
        numeric = (project_points(points, numbers + step)[0] - project_points(points, numbers - step)[0]) / (2 * STEP)
        np.testing.assert_allclose(by_lens[..., k], numeric, atol=1e-4)


def test_one_posture_equals_many():
    boarded = board()
    for rig, point in ((robots.rig(), 0), (boarded, 5), (robots.tracker(), 0)):
        theta = robots.truth(rig, {"lift": 0.1})
        theta[3:6] += [0.1, -0.2, 0.3]
        theta[rig.of_carrier(0)] += 0.05
        one = replace(rig.sights[0], points=rig.sights[0].points[[point]])
        at, q = compile_predictor(replace(rig, sights=(one,)), theta), robots.angles(4)
        seen = rig.see(rig.sights[0], theta, q)
        for k in range(4):
            many = (seen.image[k, point], seen.slope[k, point], seen.design[k, point])
            for one, other in zip(at(q[k]), many, strict=True):
                np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-7)


@pytest.mark.parametrize("rig", [robots.rig(), robots.tracker()], ids=["camera", "tracker"])
def test_rig_slopes_are_finite_differences(rig):
    theta, q, sight = robots.truth(rig, {"lift": 0.1}), robots.angles(5), rig.sights[0]
    found = rig.see(sight, theta, q)
    steps = STEP * np.eye(len(theta))
    numeric = [(rig.see(sight, theta + s, q).image - rig.see(sight, theta - s, q).image) / (2 * STEP) for s in steps]
    np.testing.assert_allclose(found.design, np.stack(numeric, axis=-1), rtol=1e-6, atol=1e-4)
    steps = STEP * np.eye(4)
    numeric = [(rig.see(sight, theta, q + s).image - rig.see(sight, theta, q - s).image) / (2 * STEP) for s in steps]
    np.testing.assert_allclose(found.slope, np.stack(numeric, axis=-1), atol=1e-4)

"""One image's posture: its mean, its covariance, and what it does not tell."""

from dataclasses import replace

import numpy as np

from bodylog.kinematics import urdf
from bodylog.kinematics.joint_motion import curve_through_samples
from bodylog.kinematics.landmark_adjustment import Landmarks
from bodylog.kinematics.landmark_errors import COMMON_STD_PX
from bodylog.kinematics.landmark_fit import build_model
from bodylog.kinematics.landmark_postures import UNTOLD_STD, posture_readings
from bodylog.kinematics.landmarks import LandmarkSightings
from bodylog.kinematics.links import Space
from tests.kinematics.landmark_arm import ARM, JOINTS, camera, model, motion, truth

BENT = np.array([0.01, -0.008, 0.012, 0.02])


def sightings(built, phi, body, places, frames=30):
    """Each landmark in each of some images, without noise."""
    count = len(body)
    piece = np.repeat(np.arange(count), frames)
    t = np.tile(np.linspace(2.0, 15.0, frames), count)
    part = LandmarkSightings(piece, np.zeros(len(piece), int), t, np.full((len(t), 2), 240.0), 480.0)
    for _ in range(3):
        part = replace(part, uv=built.predict(phi, part, body, places).image)
    return part


def drawn(built, count, links, seed=3):
    rng = np.random.default_rng(seed)
    body = np.sort(rng.choice(links, count))
    places = np.array([built.bodies[b].centre + 0.3 * built.bodies[b].size * rng.standard_normal(3) for b in body])
    return body, places


def read_wrong(count, links, phi=None):
    """Postures where the encoders read BENT too much, of a log without noise in its images."""
    real = motion(4)
    built = model([real])
    phi = truth(built, 0.04) if phi is None else phi
    body, places = drawn(built, count, links)
    part = sightings(built, phi, body, places)
    wrong = model([curve_through_samples(real.t, real.q + BENT)])
    known = np.tile(1e8 * np.eye(3), (count, 1, 1))
    t, angles, cov = posture_readings(wrong, phi, part, Landmarks(body, places), known)
    return real, t, angles, cov


def test_posture_is_that_of_the_robot_where_encoders_are_off():
    real, t, angles, _ = read_wrong(60, [1, 2, 3, 4])
    np.testing.assert_allclose(np.unique(np.linspace(2.0, 15.0, 30)) - 0.04, t, atol=1e-12)
    off = np.abs(angles - real.at(t)[0])
    assert (off.mean(axis=0) < 0.3 * np.abs(BENT)).all()


def test_many_landmarks_of_a_link_share_an_error():
    """Corners beside each other err alike: a hundred of them tell no more than the link's common error."""
    built = model([motion(4)])
    phi = truth(built)
    for count in (10, 100):
        body, places = np.full(count, 1), np.tile(built.bodies[1].centre + np.array([0.1, 0.05, 0.0]), (count, 1))
        part = sightings(built, phi, body, places, frames=6)
        known = np.tile(1e8 * np.eye(3), (count, 1, 1))
        cov = posture_readings(built, phi, part, Landmarks(body, places), known)[2]
        slopes = built.predict(phi, part, body, places).by_joints[:6, :, 0]
        least = COMMON_STD_PX / np.linalg.norm(slopes, axis=1)
        ratio = np.sqrt(cov[:, 0, 0]) / least
        assert (ratio > 1.0).all() and (ratio < 1.2).all()


def test_joint_that_no_corner_shows_stays_unknown():
    real, t, angles, cov = read_wrong(40, [1, 2])
    np.testing.assert_allclose(np.sqrt(cov[:, 3, 3]), UNTOLD_STD, rtol=1e-9)
    np.testing.assert_allclose(angles[:, 3], real.at(t)[0][:, 3] + BENT[3], atol=1e-9)


def test_camera_on_the_hand_sees_the_scene_as_landmarks_on_the_base():
    real = motion(4)
    space = Space(urdf.parse_urdf(ARM, "arm.urdf"), JOINTS, {}, np.radians(5.0))
    anchor = np.eye(4)
    anchor[:3, 3] = [0.0, 0.05, 0.02]
    mount = replace(camera(), link="hand", anchor=anchor)
    built = build_model(space, mount, [real], np.radians(5.0))
    base = next(number for number, one in enumerate(built.bodies) if one.link == "base")
    assert len(built.bodies[base].chain.column) == 4
    phi = built.prior[0].copy()
    rng = np.random.default_rng(2)
    # far before the hand wherever it looks, so that every image shows them
    body = np.full(60, base)
    turn, place = built.frames(phi, real.at(np.array([8.0 - phi[built.of_delays][0]]))[0], base, np.zeros(1, int))
    ahead = np.column_stack([rng.uniform(-0.5, 0.5, (60, 2)), rng.uniform(1.5, 3.0, 60)])
    places = (ahead - place[0]) @ turn[0]
    part = sightings(built, phi, body, places)
    near = np.abs(part.t - 8.0) < 0.5
    part = LandmarkSightings(part.piece[near], part.log[near], part.t[near], part.uv[near], 480.0)
    wrong = build_model(space, mount, [curve_through_samples(real.t, real.q + BENT)], np.radians(5.0))
    known = np.tile(1e8 * np.eye(3), (60, 1, 1))
    t, angles, _ = posture_readings(wrong, phi, part, Landmarks(body, places), known)
    assert np.abs(angles - real.at(t)[0]).max() < 0.3 * np.abs(BENT).min()

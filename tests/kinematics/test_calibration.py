"""Calibration: θ as the data was made, with true error bars, on the right links; unidentified unknowns are named."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.kinematics import identifiability, urdf
from bodylog.kinematics.calibration import Sighted, calibrate_rig
from bodylog.kinematics.links import CameraHint, MarkerTrack, find_links
from bodylog.kinematics.rig import IMAGES, SPACE, Carrier, Rig, RigCamera, Sight
from bodylog.kinematics.rotations import make_transform, rotation_from_vector
from bodylog.kinematics.starts import (
    align_points,
    find_starts,
    hand_eye,
    planar_board_pose,
    resect_pose,
)
from tests.kinematics import robots
from tests.kinematics.robots import ARM, JOINTS, board

DEGREE = np.radians(1.0)
SEEDS = range(12)


def solve(rig, data):
    anchored, first = find_starts(rig, [data])
    return calibrate_rig(anchored, [data], first)


@pytest.mark.parametrize("known", [True, False])
def test_forty_poses_predict_the_next_ones(known):
    rig = robots.rig(known=known)
    theta = robots.truth(rig, {"elbow": 2 * DEGREE})
    found = solve(rig, robots.seen(rig, theta, robots.angles(40), 0.3))
    q = robots.angles(200, seed=9)
    there = found.rig.see(found.rig.sights[0], found.theta, q).image
    error = there - rig.see(rig.sights[0], theta, q).image
    assert np.sqrt(np.square(error).mean()) < 0.35
    assert 0.2 < np.sqrt(found.noise[IMAGES]) < 0.4


def test_offsets_have_true_error_bars():
    """NEES near 1 over seeds, of the zeros that are identifiable."""
    squares = []
    for seed in SEEDS:
        rig = robots.rig()
        mean, std = rig.prior
        draw = np.random.default_rng(100 + seed)
        theta = mean + std * draw.normal(size=len(mean)) * np.where(std > 0.2, 0.1, 1.0)
        theta[rig.of_joints] = draw.normal(0.0, 2 * DEGREE, 4)
        found = solve(rig, robots.seen(rig, theta, robots.angles(40, seed=seed), 0.3, seed=seed))
        part = slice(rig.of_joints.start + 1, rig.of_joints.start + 3)  # lift and elbow
        off = found.theta[part] - theta[part]
        squares.append(off @ np.linalg.solve(found.covariance[part, part], off) / 2)
    assert 0.6 < np.mean(squares) < 1.6  # 24 degrees of freedom: 1 ± 0.3


def test_false_sightings_do_not_move_the_calibration():
    rig = robots.rig()
    theta = robots.truth(rig)
    data = robots.seen(rig, theta, robots.angles(60), 0.3)
    clean = solve(rig, data)
    image = data.image.copy()
    image[::10] += 80.0
    image[5] = np.nan
    found = solve(rig, replace(data, image=image))
    assert np.array_equal(np.flatnonzero(found.weights[0][:, 0] < 0.5), [0, 5, 10, 20, 30, 40, 50])
    part = rig.of_joints
    moved = (found.theta - clean.theta)[part] / np.sqrt(np.diag(found.covariance))[part]
    assert np.abs(moved).max() < 1.0


def test_unidentified_unknowns_are_named_without_a_value():
    rig = robots.rig(known=False)
    found = solve(rig, robots.seen(rig, robots.truth(rig), robots.angles(80), 0.3))
    offsets = {one.joint: one for one in identifiability.joint_zeros(found.rig, found.theta, found.covariance)}
    assert [name for name, one in offsets.items() if one.identifiable] == ["lift", "elbow"]
    text = "; ".join(identifiability.describe_unidentified(list(offsets.values())))
    assert "pan: its zero cannot be separated from camera's" in text and "turn about the z axis of base" in text
    assert "wrist: its zero cannot be separated from point's place" in text


def test_calibrate_with_a_zero_offset_prior_fixes_offsets():
    rig = robots.rig(doubt=1e-9)
    found = solve(rig, robots.seen(rig, robots.truth(rig), robots.angles(40), 0.3))
    assert np.abs(found.theta[rig.of_joints]).max() < 1e-8


@pytest.mark.parametrize("swapped", [False, True])
def test_links_of_camera_and_marker_are_found_by_evidence(swapped):
    robot = urdf.parse_urdf(ARM, "arm.urdf")
    rig = robots.rig(known=False)
    theta = robots.truth(rig)
    data = robots.seen(rig, theta, robots.angles(60), 0.3)
    if swapped:  # the camera on the tool looks at a point beside the base
        data = _eye_in_hand(robots.angles(60))
    track = MarkerTrack("", "point", data)
    found = find_links(robot, JOINTS, {}, {"point": track}, {"": CameraHint(size=(640, 480))}, 5 * DEGREE)
    best = found.calibrated.rig
    links = best.cameras[0].link, best.carriers[0].link
    assert links == (("hand", "base") if swapped else ("base", "hand"))
    assert found.margin is not None and found.margin > 20 and np.sqrt(found.calibrated.noise[IMAGES]) < 0.5


def _eye_in_hand(q):
    robot = urdf.parse_urdf(ARM, "arm.urdf")
    from bodylog.kinematics.chain import chain_between

    chain = chain_between(robot, "tool", "base").over(JOINTS)
    place = chain.at(np.median(q, axis=0)[None])
    target = np.array([0.6, 0.2, 0.0])
    inside = place.rotation[0] @ target + place.place[0]
    axis = inside / np.linalg.norm(inside)
    from bodylog.kinematics.rotations import rotation_from_z

    anchor = make_transform(rotation_from_z(axis).T, np.zeros(3))
    doubt = np.ones(12)
    rig = Rig(
        (RigCamera("c", "tool", anchor, np.array([np.log(600.0), 0.0, 320.0, 240.0, 0.0, 0.0]), doubt),),
        (Carrier("p", "base", make_transform(np.eye(3), target), np.ones(3)),),
        (Sight("s", 0, 0, chain),),
        JOINTS,
        np.ones(4),
    )
    return robots.seen(rig, rig.prior[0], q, 0.3)


def test_calibrate_finds_a_hand_board_from_its_corners():
    rig = board()
    theta = rig.prior[0].copy()
    theta[rig.of_joints] = np.array([0.0, 1.0, -1.5, 0.0]) * DEGREE
    q = robots.angles(25)
    image = rig.see(rig.sights[0], theta, q).image + np.random.default_rng(3).normal(0.0, 0.2, (25, 12, 2))
    image[np.random.default_rng(4).random((25, 12)) < 0.2] = np.nan
    blind = replace(
        rig,
        cameras=(replace(rig.cameras[0], anchor=np.eye(4)),),
        carriers=(replace(rig.carriers[0], anchor=np.eye(4)),),
    )
    found = solve(blind, Sighted(q, image, np.zeros(image.shape)))
    assert 0.15 < np.sqrt(found.noise[IMAGES]) < 0.25
    offsets = {one.joint: one for one in identifiability.joint_zeros(found.rig, found.theta, found.covariance)}
    assert not offsets["pan"].identifiable and not offsets["wrist"].identifiable
    for name, true in (("lift", 1.0), ("elbow", -1.5)):
        assert offsets[name].identifiable and offsets[name].std < 0.3 * DEGREE
        assert abs(offsets[name].value - true * DEGREE) < 3 * offsets[name].std


def test_starts_are_exact_without_noise():
    draw = np.random.default_rng(5)
    pose = make_transform(rotation_from_vector(draw.normal(size=3)), np.array([0.1, -0.2, 3.0]))
    points = draw.uniform(-1, 1, (20, 3))
    inside = points @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(resect_pose(points, inside[:, :2] / inside[:, 2:]), pose, atol=1e-6)
    assert resect_pose(points[:4], points[:4, :2]) is None
    flat = points * [1.0, 1.0, 0.0]
    inside = flat @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(planar_board_pose(flat, inside[:, :2] / inside[:, 2:]), pose, atol=1e-6)
    x, z = (make_transform(rotation_from_vector(draw.normal(size=3)), draw.normal(size=3)) for _ in range(2))
    links = [make_transform(rotation_from_vector(draw.normal(size=3)), draw.normal(size=3)) for _ in range(8)]
    found = hand_eye([x @ link @ z for link in links], links)
    np.testing.assert_allclose(found, (x, z), atol=1e-6)


def test_tracker_on_the_base_is_found_among_false_points():
    """A tenth of the points are false; the tracker's link, its frame and the noise are found all the same."""
    rig = robots.tracker()
    theta = rig.prior[0].copy()
    theta[rig.of_carrier(0)] = [0.02, -0.03, 0.02]
    data = robots.seen(rig, theta, robots.angles(60), 0.2)
    draw = np.random.default_rng(6)
    data.image[draw.random(60) < 0.1] += draw.normal(0.0, 100.0, 3)
    track = MarkerTrack("tracker", "ball", data)
    found = find_links(urdf.parse_urdf(ARM, "arm.urdf"), JOINTS, {}, {"tracker/ball": track}, {}, 5 * DEGREE)
    best = found.calibrated
    assert (best.rig.cameras[0].link, best.rig.carriers[0].link) == ("base", "hand") and best.rig.cameras[0].tracks_space
    assert found.margin is not None and found.margin > 20 and 0.15 < np.sqrt(best.noise[SPACE]) < 0.25
    above = np.array([0.0, 0.0, 1.0, 1.0])
    np.testing.assert_allclose(best.rig.camera_pose(0, best.theta) @ above, robots.camera_pose() @ above, atol=2e-3)


def test_pose_that_aligns_points_in_space():
    draw = np.random.default_rng(1)
    points = draw.normal(0.0, 0.5, (30, 3))
    pose = make_transform(rotation_from_vector(np.array([0.4, 2.0, -1.0])), np.array([3.0, -1.0, 0.5]))
    seen = points @ pose[:3, :3].T + pose[:3, 3]
    seen[3] += 5.0  # a false point
    np.testing.assert_allclose(align_points(points, seen), pose, atol=0.02)
    assert align_points(points[:5], seen[:5]) is None

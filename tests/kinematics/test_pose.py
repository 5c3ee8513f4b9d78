"""A thing's pose in the robot's base, its covariance, and its scores."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.evaluation import poses as figures
from bodylog.evaluation.truth import load_poses
from bodylog.kinematics import urdf
from bodylog.kinematics.chain import chain_between
from bodylog.kinematics.pose import bend_still_joints, find_base, pose_in_base, rise_in_base
from bodylog.kinematics.rig import Sight
from bodylog.kinematics.rotations import (
    quaternions_from_rotations,
    rotation_from_vector,
    vector_from_rotation,
)
from bodylog.types import Poses
from tests.kinematics import robots
from tests.kinematics.robots import ARM

STEP = 1e-6
OFFSETS = {"lift": 0.03, "elbow": -0.02}


def _posed(rig, theta, q, cov=None, camera=False):
    base = find_base(urdf.parse_urdf(ARM, "arm"), rig, theta, {})
    root = np.diag(rig.prior[1]) * 0.01
    return base, pose_in_base(base, rig, theta, root, q, np.zeros((len(q), 4, 4)) if cov is None else cov)


@pytest.mark.parametrize("thing", ["point", "board"])
def test_posed_equals_the_chain_with_sampled_covariance(thing):
    rig = robots.rig() if thing == "point" else robots.board()
    theta, q = robots.truth(rig, OFFSETS), robots.angles(5)
    draw = np.random.default_rng(1).normal(size=(5, 4, 4)) * 0.02
    cov = draw @ draw.transpose(0, 2, 1)
    base, (place, rotation, spread) = _posed(rig, theta, q, cov)
    chain = rig.sights[0].chain.at(q + theta[rig.of_joints])
    on_link = rig.carrier_pose(0, theta)
    np.testing.assert_allclose(place, chain.place + chain.rotation @ on_link[:3, 3], atol=1e-12)
    assert (base.chain.start, base.link, base.camera) == ("base", "tool", False)
    if thing == "board":
        np.testing.assert_allclose(rotation, chain.rotation @ on_link[:3, :3], atol=1e-12)
    by_joints, by_theta = np.zeros((5, 6, 4)), np.zeros((5, 6, len(theta)))
    for by, size in ((by_joints, 4), (by_theta, len(theta))):
        for k in range(size):
            step = STEP * (np.arange(size) == k)
            ends = [(q + way, theta) if by is by_joints else (q, theta + way) for way in (step, -step)]
            above, below = (_posed(rig, at, angles)[1] for angles, at in ends)
            by[:, :3, k] = (above[0] - below[0]) / (2 * STEP)
            turns = [vector_from_rotation(a @ b.T) for a, b in zip(above[1], below[1], strict=True)]
            by[:, 3:, k] = np.array(turns) / (2 * STEP)
    unknown = by_theta * rig.prior[1] * 0.01
    expected = by_joints @ cov @ by_joints.transpose(0, 2, 1) + unknown @ unknown.transpose(0, 2, 1)
    np.testing.assert_allclose(spread, expected, atol=1e-6 * np.abs(expected).max())


def test_a_marker_rises_as_its_place_in_the_base_does():
    rig = robots.rig()
    theta, q = robots.truth(rig, OFFSETS), robots.angles(5)
    base, _ = _posed(rig, theta, q)
    found = rise_in_base(base, rig, theta, q)
    for k, step in enumerate(STEP * np.eye(q.shape[1])):
        above, below = (_posed(rig, theta, q + way)[1][0][:, 2] for way in (step, -step))
        np.testing.assert_allclose(found[:, k], (above - below) / (2 * STEP), atol=1e-7)
    # the marker is beyond its link's last joint, which lifts it, too
    assert (np.abs(found).max(axis=0) > 1e-3).sum() >= 2


def test_a_joint_that_stood_still_moves_a_marker_that_it_may_carry():
    robot, whole = urdf.parse_urdf(ARM, "arm"), robots.rig()
    joints, still = robots.JOINTS[:3], {"wrist": 0.4}
    to_fore = chain_between(robot, "base", "fore").over(joints)
    rig = replace(
        whole,
        carriers=(replace(whole.carriers[0], link="fore"),),
        sights=(Sight("point", 0, 0, to_fore),),
        joints=joints,
        doubt=whole.doubt[:3],
    )
    theta, q = robots.truth(whole, OFFSETS)[:-1], robots.angles(5)[:, :3]
    base = find_base(robot, rig, theta, still)
    assert base.still_joints == ("wrist",)
    moved, rise = bend_still_joints(base, rig, theta, q)
    angles = q + theta[rig.of_joints]
    fore = to_fore.at(angles)
    place = fore.place + fore.rotation @ rig.carrier_pose(0, theta)[:3, 3]
    to_tool = chain_between(robot, "base", "tool").over(robots.JOINTS)
    rests, above, below = (
        to_tool.at(np.column_stack([angles, np.full(5, still["wrist"] + way)]))
        for way in (0.0, STEP, -STEP)
    )
    on_tool = np.einsum("nji,nj->ni", rests.rotation, place - rests.place)
    ends = [one.place + np.einsum("nij,nj->ni", one.rotation, on_tool) for one in (above, below)]
    expected = (ends[0] - ends[1]) / (2 * STEP)
    np.testing.assert_allclose(rise[:, 0], expected[:, 2], atol=1e-8)
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", fore.rotation, moved[..., 0]), expected, atol=1e-8
    )
    assert np.linalg.norm(expected, axis=1).min() > 0.01
    moving = find_base(robot, whole, robots.truth(whole, OFFSETS), {})
    assert moving.hand is None and moving.still_joints == ()


def test_posed_takes_a_moving_camera_as_the_effector():
    robot, rig = urdf.parse_urdf(ARM, "arm"), robots.rig()
    chain = chain_between(robot, "tool", "base").over(robots.JOINTS)
    swapped = replace(
        rig,
        cameras=(replace(rig.cameras[0], link="tool", anchor=np.eye(4)),),
        carriers=(replace(rig.carriers[0], link="base"),),
        sights=(Sight("point", 0, 0, chain),),
    )
    theta, q = swapped.prior[0].copy(), robots.angles(4)
    base = find_base(robot, swapped, theta, {})
    place, rotation, _ = pose_in_base(base, swapped, theta, np.zeros((len(theta), 1)), q, np.zeros((4, 4, 4)))
    poses = rig.sights[0].chain.at(q)
    assert base.camera
    np.testing.assert_allclose(place, poses.place, atol=1e-12)
    np.testing.assert_allclose(rotation, poses.rotation, atol=1e-12)


def test_quaternions_are_rotations_at_any_angle():
    draw = np.random.default_rng(3)
    vectors = [*draw.normal(size=(40, 3)), np.array([np.pi, 0, 0]), np.array([0, np.pi, 0]), np.array([0, 0, np.pi])]
    rotations = np.array([rotation_from_vector(v) for v in vectors])
    x, y, z, w = quaternions_from_rotations(rotations).T
    back = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])  # fmt: skip
    np.testing.assert_allclose(back.transpose(2, 0, 1), rotations, atol=1e-12)


def _some(count=400, seed=0, cov=True):
    draw, t = np.random.default_rng(seed), np.arange(count) / 100.0
    turns = [rotation_from_vector(np.array([0.3 * np.sin(s), 0.2 * s, 0.1])) for s in t]
    true = Poses(t, np.column_stack([np.sin(t), np.cos(t), 0.1 * t]), quaternions_from_rotations(np.array(turns)), "base", t)
    error = draw.normal(size=(count, 6)) * [0.01, 0.02, 0.01, 0.05, 0.03, 0.04]
    off = np.array([rotation_from_vector(e) @ turn for e, turn in zip(error[:, 3:], turns, strict=True)])
    spread = np.broadcast_to(np.diag(np.square([0.01, 0.02, 0.01, 0.05, 0.03, 0.04])), (count, 6, 6))
    return Poses(t, true.place + error[:, :3], quaternions_from_rotations(off), "base", t, spread if cov else None), true


def test_true_error_bars_have_a_nees_of_one():
    found, true = _some()
    values = {score.name: score.value for score in figures.score_poses(found, true)}
    assert values["rmse/effector_position"] == pytest.approx(np.sqrt(6e-4), rel=0.1)
    assert values["rmse/effector_rotation"] == pytest.approx(np.sqrt(5e-3), rel=0.1)
    for part in ("position", "rotation"):
        assert values[f"nees/effector_{part}"] == pytest.approx(1.0, abs=0.1)
        assert 93 < values[f"coverage_2sigma/effector_{part}"] < 98


def test_pose_scores_of_positions_omit_rotations(tmp_path):
    found, true = _some()
    rows = "\n".join(f"{t},{x},{y},{z}" for t, (x, y, z) in zip(true.t, true.place, strict=True))
    (tmp_path / "laser.csv").write_text("t,x,y,z\n" + rows)
    values = {s.name: s.value for s in figures.score_poses(found, load_poses(tmp_path / "laser.csv", 0))}
    assert values["nees/effector_position"] == pytest.approx(1.0, abs=0.1) and "rmse/effector_rotation" not in values
    (tmp_path / "joints.csv").write_text("t,pan\n0,1\n")
    assert load_poses(tmp_path / "joints.csv", 0) is None and load_poses(tmp_path / "x.npz", 0) is None


def test_disjoint_times_have_no_score():
    found, true = _some()
    assert figures.score_poses(found, Poses(true.t + 100.0, true.place, true.turn, "base", true.t)) == ()

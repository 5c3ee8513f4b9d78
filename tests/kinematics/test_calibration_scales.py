"""Joint scales as unknowns: derivatives by finite differences, found where wrong, not claimed where right."""


import numpy as np
import pytest

from bodylog.kinematics import identifiability, urdf
from bodylog.kinematics.instant import compile_predictor
from bodylog.kinematics.pose import find_base, pose_in_base
from tests.kinematics import robots
from tests.kinematics.robots import ARM, JOINTS
from tests.kinematics.scaled_joints import STEP, scaled, solve


@pytest.mark.parametrize("make", [robots.rig, robots.board])
def test_slopes_by_scales_and_readings_are_finite_differences(make):
    rig, q = scaled(make()), robots.angles(4)
    theta = rig.prior[0] + np.random.default_rng(0).normal(0.0, 0.01, len(rig.prior[0]))
    sight = rig.sights[0]
    seen = rig.see(sight, theta, q)
    steps = STEP * np.eye(len(theta))
    by_theta = [(rig.see(sight, theta + s, q).image - rig.see(sight, theta - s, q).image) / (2 * STEP) for s in steps]
    np.testing.assert_allclose(seen.design, np.stack(by_theta, axis=-1), rtol=1e-5, atol=2e-3)
    steps = STEP * np.eye(len(JOINTS))
    by_q = [(rig.see(sight, theta, q + s).image - rig.see(sight, theta, q - s).image) / (2 * STEP) for s in steps]
    np.testing.assert_allclose(seen.slope, np.stack(by_q, axis=-1), rtol=1e-5, atol=2e-3)
    for k, (image, slope, design) in enumerate(map(compile_predictor(rig, theta), q)):
        for one, many in ((image, seen.image), (slope, seen.slope), (design, seen.design)):
            np.testing.assert_allclose(one, many[k, 0], rtol=1e-9, atol=1e-9)


def test_pose_covariance_includes_readings_and_scales():
    rig, q = scaled(robots.board()), robots.angles(3)
    theta = rig.prior[0] + np.random.default_rng(1).normal(0.0, 0.01, len(rig.prior[0]))
    base, size = find_base(urdf.parse_urdf(ARM, "arm.urdf"), rig, theta, {}), len(theta)
    m = 2
    index = rig.of_scales.start + m
    root, none = np.zeros((size, 1)), np.zeros((3, 4, 4))
    root[index] = 1.0
    step = STEP * np.eye(size)[index]
    ends = [pose_in_base(base, rig, theta + way, np.zeros((size, 1)), q, none)[0] for way in (step, -step)]
    by_scale = (ends[0] - ends[1]) / (2 * STEP)
    spread = pose_in_base(base, rig, theta, root, q, none)[2][:, :3, :3]
    np.testing.assert_allclose(spread, by_scale[:, :, None] * by_scale[:, None], atol=1e-6)
    only = none + np.diag(np.eye(4)[m])
    shift = STEP * np.eye(4)[m]
    ends = [pose_in_base(base, rig, theta, 0 * root, q + way, none)[0] for way in (shift, -shift)]
    by_q = (ends[0] - ends[1]) / (2 * STEP)
    spread = pose_in_base(base, rig, theta, 0 * root, q, only)[2][:, :3, :3]
    np.testing.assert_allclose(spread, by_q[:, :, None] * by_q[:, None], atol=1e-6)


def test_calibrate_finds_only_the_joint_of_wrong_scale():
    """Over 10 seeds and two joints: within 2σ, with true error bars."""
    standard, of_others = [], []
    for seed in range(10):
        rig, m = scaled(robots.rig()), 1 + seed % 2
        theta = robots.truth(rig, {"elbow": 0.02}, seed)
        theta[rig.of_scales] = 0.03 * (np.arange(4) == m)
        found = solve(rig, robots.seen(rig, theta, robots.angles(80, seed), 0.3, seed))
        scales = identifiability.joint_scales(found.rig, found.theta, found.covariance)
        assert scales[m].identifiable and scales[m].value > 2 * scales[m].std, seed
        standard.append((scales[m].value - 0.03) / scales[m].std)
        of_others += [one.value / one.std for k, one in enumerate(scales) if k != m and one.identifiable]
    assert np.mean(np.abs(standard) < 2) >= 0.9 and 0.3 < np.mean(np.square(standard)) < 2.2
    assert np.mean(np.abs(of_others) < 2) >= 0.85


def test_fixed_scales_are_neither_reported_nor_unknowns():
    rig = robots.rig()
    data = robots.seen(rig, robots.truth(rig, {"elbow": 0.02}), robots.angles(60), 0.3)
    found = solve(rig, data)
    assert identifiability.joint_scales(found.rig, found.theta, found.covariance) == ()
    unknown = solve(scaled(rig), data)
    found = identifiability.joint_scales(unknown.rig, unknown.theta, unknown.covariance)
    assert [one.joint for one in found] == list(JOINTS)
    assert all(abs(one.value) < 2.5 * one.std for one in found)
    silent = [one for one in found if not one.identifiable]
    assert all("its scale cannot be separated from" in line for line in identifiability.describe_unidentified(silent))

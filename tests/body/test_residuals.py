"""Joints' errors over a turn look like zeros over a small range: the zeros' error bars contain them."""

from types import SimpleNamespace

import numpy as np

from bodylog.body.gp.marginal_likelihood import cholesky_with_jitter, independent_noise
from bodylog.body.kinematic import adjusting
from bodylog.body.kinematic.explicit import ResidualRows, solve_linear_unknowns
from bodylog.body.kinematic.model import KinematicGP
from bodylog.body.kinematic.residuals import PERIODIC_STD_RAD, with_periodic_errors
from bodylog.body.kinematic.sightings import PointMeans
from tests.body import camera_arms
from tests.kinematics import robots

NOISE_PX = 0.1


def deviations(periodic: bool, draws: int = 40) -> np.ndarray:
    """Errors of the zeros in their std, over robots whose joints have periodic errors, linear in all else."""
    rig = robots.rig()
    theta = rig.prior[0]
    std = rig.prior[1]
    q = robots.angles(60)
    draw = np.random.default_rng(0)
    view = PointMeans(q, np.zeros(len(q), int), np.zeros((1, 0)), np.arange(len(q)), np.ones((len(q), 1)))
    seen = rig.see(rig.sights[0], theta, q)
    noise = cholesky_with_jitter(np.zeros((len(q), len(q))), independent_noise(np.full((len(q), 2), NOISE_PX**2)), 0.0)
    found = []
    for _ in range(draws):
        true = draw.normal(0.0, std)
        true[rig.of_carrier(0)] *= 0.05
        cosine, sine = draw.normal(0.0, PERIODIC_STD_RAD, (2, 4))
        at = theta + true
        image = rig.see(rig.sights[0], at, q + cosine * np.cos(q) + sine * np.sin(q)).image[:, 0]
        image = image + draw.normal(0.0, NOISE_PX, image.shape)
        seen = rig.see(rig.sights[0], at, q)
        residual = image - seen.image[:, 0] + seen.design[:, 0] @ true
        rows = ResidualRows(q, residual, seen.design[:, 0] * std, independent_noise(np.full((len(q), 2), NOISE_PX**2)))
        rows = with_periodic_errors(rig, rows, SimpleNamespace(view=view)) if periodic else rows
        answer = solve_linear_unknowns(noise, rows)
        spread = np.sqrt(np.square(answer.root).sum(axis=1))[: len(std)]
        found.append(((std * answer.mean[: len(std)] - true) / (std * spread))[rig.of_joints])
    return np.array(found)


def test_error_bars_of_zeros_contain_periodic_errors():
    apart = deviations(periodic=True)
    assert 0.6 < np.mean(apart**2) < 1.5
    assert np.mean(deviations(periodic=False) ** 2) > 2.0  # what they would be without


def test_joints_that_slide_or_have_given_zeros_have_none():
    rig = robots.rig(doubt=1e-9)
    q = robots.angles(5)
    seen = rig.see(rig.sights[0], rig.prior[0], q)
    rows = ResidualRows(q, np.zeros((5, 2)), seen.design[:, 0] * rig.prior[1], independent_noise(np.ones((5, 2))))
    view = PointMeans(q, np.zeros(5, int), np.zeros((1, 0)), np.arange(5), np.ones((5, 1)))
    assert with_periodic_errors(rig, rows, SimpleNamespace(view=view)).design.shape == rows.design.shape
    turning = with_periodic_errors(robots.rig(), rows, SimpleNamespace(view=view))
    assert turning.design.shape[2] == rows.design.shape[2] + 8


def test_a_calibration_that_does_not_settle_leaves_the_urdf_unused(monkeypatch):
    """Images that err by more than their residuals led a step to infinity."""
    read = adjusting._further_readings

    def misread(*given):
        angles = read(*given)
        return angles + np.random.default_rng(4).normal(0.0, 0.02, angles.shape)

    monkeypatch.setattr(adjusting, "_further_readings", misread)
    found = camera_arms.learn()
    assert not any(isinstance(sense, KinematicGP) for sense in found.model.senses.values())
    assert any("the URDF is not used: its calibration does not settle" in one.text for one in found.findings)

"""An adjustment: its derivatives, its solution and its covariance by other ways."""

import numpy as np
from scipy.optimize import least_squares

from bodylog.kinematics.adjustment import MOST_SIGMA, ZERO_SIGMA, Adjusted, Known, Posed, adjust
from bodylog.kinematics.calibration import Sighted
from tests.kinematics import robots

NOISE = 0.5
"""Standard deviation of a point, px."""
ZEROS = {"lift": 0.03, "elbow": -0.02}
RIG = robots.rig()
TRUTH = robots.truth(RIG, ZEROS)


def sightings(seed: int, truth: np.ndarray = TRUTH) -> Posed:
    """25 still poses with exact angles, each a group of its own."""
    q = robots.angles(25, seed)
    draw = np.random.default_rng(seed + 1000)
    image = RIG.see(RIG.sights[0], truth, q).image
    image = image + draw.normal(0.0, NOISE, image.shape)
    sighted = Sighted(q, image, np.zeros(image.shape))
    return Posed(sighted, np.zeros(q.shape), np.zeros(25, int), np.arange(25))


def vague() -> Known:
    """Nothing is known: no bound holds anything."""
    return known_at(TRUTH, 1e3)


def known_at(theta: np.ndarray, times: float) -> Known:
    """θ is known there, to some times the prior's standard deviations."""
    return Known(np.arange(len(theta)), theta.copy(), np.diag(np.square(times * RIG.prior[1])))


def adjusted(seed: int, known: Known) -> Adjusted:
    return adjust(RIG, [sightings(seed)], TRUTH, np.full(2, NOISE**2), known)


def plain_cost(one: Posed, theta: np.ndarray) -> np.ndarray:
    """Residuals in standard deviations, and θ about its prior."""
    mean, std = RIG.prior
    off = RIG.see(RIG.sights[0], theta, one.sighted.q).image - one.sighted.image
    return np.concatenate([off.ravel() / NOISE, (theta - mean) / std])


def test_derivatives_are_those_of_finite_differences():
    one = sightings(3)
    seen = RIG.see(RIG.sights[0], TRUTH, one.sighted.q)
    for index, std in enumerate(RIG.prior[1]):
        step = np.zeros(len(TRUTH))
        step[index] = 1e-4 * std
        above, below = (RIG.see(RIG.sights[0], TRUTH + way, one.sighted.q).image for way in (step, -step))
        np.testing.assert_allclose(seen.design[..., index], (above - below) / (2e-4 * std), rtol=1e-4, atol=1e-4 / std)


def test_solution_is_that_of_plain_least_squares():
    one = sightings(5)
    found = adjusted(5, vague())
    # the adjustment learns the noise and has errors of joints: the weights of prior and images differ by little
    std = RIG.prior[1]
    plain = least_squares(lambda z: plain_cost(one, RIG.prior[0] + std * z), (TRUTH - RIG.prior[0]) / std)
    sigma = np.sqrt(np.diag(found.curvature))
    assert (np.abs(found.theta - RIG.prior[0] - std * plain.x) < 0.1 * sigma).all()


def test_loss_curvature_is_the_scatter_over_drawn_truths():
    """Camera, lens and zeros drawn from their priors: what is left of them has the stated covariance."""
    ratios = []
    rest = np.setdiff1d(np.arange(len(TRUTH)), np.arange(RIG.of_carrier(0).start, RIG.of_carrier(0).stop))
    for seed in range(40):
        truth = TRUTH.copy()
        mean, std = RIG.prior
        truth[rest] = np.random.default_rng(seed).normal(mean, std)[rest]
        found = adjust(RIG, [sightings(seed, truth=truth)], truth, np.full(2, NOISE**2), vague())
        away = (found.theta - truth)[rest]
        ratios.append(away @ np.linalg.solve(found.curvature[np.ix_(rest, rest)], away) / len(away))
    assert 0.8 < np.mean(ratios) < 1.25


def test_zeros_stay_near_what_is_known_and_the_step_widens_them():
    """What is known of a zero is wrong by 3 sigma: the zero moves by the bound, and the covariance has the move."""
    lift = RIG.of_joints.start + 1
    known = known_at(TRUTH, 0.01)
    sigma = np.sqrt(known.covariance[lift, lift])
    known.mean[lift] += 3.0 * sigma
    known.covariance[: RIG.of_joints.start] *= 1e4
    found = adjusted(1, known)
    away = found.theta - known.mean
    assert 0.8 * ZERO_SIGMA < abs(away[lift] / sigma) < 1.2 * ZERO_SIGMA
    assert (np.abs(away) < 1.1 * MOST_SIGMA * np.sqrt(np.diag(known.covariance))).all()
    np.testing.assert_allclose(found.covariance, known.covariance + np.outer(away, away), rtol=1e-9, atol=1e-18)

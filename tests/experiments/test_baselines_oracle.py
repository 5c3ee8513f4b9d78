"""The oracle: its motion is the textbook's, and evidence tells jerk from acceleration."""

import numpy as np
import pytest
from scipy.linalg import expm

from bodylog.experiments.baselines import (
    DENSITIES,
    OracleInputs,
    _filter_forward,
    discretise_motion,
    estimate_by_oracle,
)
from bodylog.sim.arms import ARMS
from tests.estimation import textbook

JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
HOME = np.array(ARMS["ur5"].home[:3])


@pytest.mark.parametrize("order", [2, 3])
def test_motion_is_van_loans(order):
    """Transition and noise from one matrix exponential."""
    dt, a = 0.3, np.diag(np.ones(order - 1), 1)
    drive = np.zeros((order, order))
    drive[-1, -1] = 1.0
    both = expm(dt * np.block([[-a, drive], [np.zeros_like(a), a.T]]))
    move, noise = discretise_motion(order, dt, 1)
    assert np.allclose(move, both[order:, order:].T) and np.allclose(
        noise, both[order:, order:].T @ both[:order, order:]
    )


def simulated(order, seed=0, count=300):
    """Joints driven by white acceleration or jerk, seen by encoders and camera."""
    from bodylog.experiments.drawn import place_in_image

    draw, dt = np.random.default_rng(seed), 0.02
    move, noise = discretise_motion(order, dt, 3)
    root, z, x = np.linalg.cholesky({2: 0.03, 3: 0.3}[order] * noise), np.zeros(3 * order), []
    for _ in range(count):
        z = move @ z + root @ draw.standard_normal(3 * order)
        x.append(HOME + z[:3])
    true, t = np.array(x), dt * np.arange(count)
    seen = place_in_image(true) + 0.3 * draw.standard_normal((count, 2))
    seen[np.arange(count) % 2 == 1] = np.nan
    return OracleInputs(t, true + 0.02 * draw.standard_normal(true.shape), seen, 0.02**2, np.full(2, 0.09)), true


@pytest.mark.parametrize("order", [2, 3])
def test_known_finds_the_order_of_motion_by_evidence(order):
    sensed, true = simulated(order)
    found = estimate_by_oracle(sensed)
    assert found.order == order
    errors = [np.sqrt(np.mean((x - true)[50:] ** 2)) for x in (sensed.encoders, found.filtered, found.smoothed)]
    assert errors[0] > 2 * errors[1] > 2 * errors[2]


def test_oracle_filter_equals_the_textbook_filter():
    sensed, _ = simulated(2, count=120)
    eye = textbook.eyes(ARMS["ur5"], JOINTS, (320, 240))[0]
    frames = [(eye, sensed.place, sensed.pixel_var)]
    theirs = textbook.filtered(sensed.t, sensed.encoders, np.full(3, 0.02**2), frames, DENSITIES[2][:2])[0]
    mine = _filter_forward(sensed, 2, DENSITIES[2][:2], None).mean
    assert np.abs(mine - theirs)[10:, :, :3].max() < 5e-4  # theirs linearises each frame three times

"""The banded solve against textbook recursions in full matrices, for both orders of motion and with offsets."""

from dataclasses import replace
from itertools import pairwise
from math import factorial

import numpy as np
import pytest

from bodylog.estimation import estimate
from bodylog.estimation.faults.screening import screened
from bodylog.estimation.inference.assemble import NEVER, START_STD, assemble, initial_states
from bodylog.estimation.inference.beliefs import given_all, given_past
from bodylog.estimation.inference.initial_path import OFFSET_STD
from bodylog.estimation.inference.mixture import inlier
from bodylog.estimation.inference.motion_model import MotionModel
from bodylog.estimation.inference.solver import solve
from bodylog.estimation.measurements.timeline import timeline
from bodylog.settings import Estimation
from tests.estimation.conftest import draw

ENCODERS = ("encoders",)
R = np.array([4e-4, 5e-4, 6e-4])
PROCESS = {2: np.array([0.3, 0.5, 1.0]), 3: np.array([9.0, 15.0, 30.0])}
WALK = np.array([1e-4, 0.0, 1e-6])
CASES = [(2, None), (3, None), (2, WALK), (3, WALK)]


def posed(features, body, motion, encoder=R):
    found = screened(features, body, Estimation(senses=ENCODERS))
    line = timeline(found, None)
    return assemble(found.encoders, line, found.first, encoder, motion), found.encoders, line, found.first


def textbook(found, line, start, motion, encoder):
    """Means and covariances of filter and smoother at every instant, and nats."""
    m, order, s = 3, motion.order, motion.states
    k = m * s
    z, last, rows = np.zeros(k), line.t[0], []
    z[::s] = start
    var = np.square(START_STD[:order])
    p = np.zeros((k, k))
    for j in range(m):
        own = np.append(var, [] if motion.walk is None else [offset_var(motion.walk[j])])
        p[j * s : j * s + s, j * s : j * s + s] = np.diag(own)
    for i, now in enumerate(line.t):
        dt, last = now - last, now
        f, q = np.eye(k), np.zeros((k, k))
        for j in range(m):
            for a in range(order):
                for b in range(order):
                    if b >= a:
                        f[j * s + a, j * s + b] = dt ** (b - a) / factorial(b - a)
                    power = 2 * order - 1 - a - b
                    q[j * s + a, j * s + b] = (
                        motion.process[j] * dt**power / (power * factorial(order - 1 - a) * factorial(order - 1 - b))
                    )
            if motion.walk is not None:
                q[j * s + s - 1, j * s + s - 1] = motion.walk[j] * dt
        zp, pp = f @ z, f @ p @ f.T + q
        h, y, r = [], [], []
        row = np.flatnonzero(line.encoders == i)
        for j in range(m) if len(row) else ():
            reading = found.values[row[0], j]
            if np.isfinite(reading):
                h.append(np.zeros(k))
                h[-1][j * s] = 1.0
                if motion.walk is not None:
                    h[-1][j * s + s - 1] = 1.0
                y.append(reading)
                r.append(encoder[j])
        cost, z, p = 0.0, zp, pp
        if y:
            hm = np.array(h)
            total, nu = hm @ pp @ hm.T + np.diag(r), np.array(y) - hm @ zp
            gain = np.linalg.solve(total, hm @ pp).T
            keep = np.eye(k) - gain @ hm
            z, p = zp + gain @ nu, keep @ pp @ keep.T + gain @ np.diag(r) @ gain.T
            cost = 0.5 * (nu @ np.linalg.solve(total, nu) + np.linalg.slogdet(2 * np.pi * total)[1])
        rows.append((f, zp, pp, z, p, cost))
    smooth, cov = [rows[-1][3]], [rows[-1][4]]
    for (*_, z, p, _), (f, zp, pp, *_) in zip(rows[-2::-1], rows[:0:-1], strict=True):
        gain = np.linalg.solve(pp, f @ p).T
        smooth.append(z + gain @ (smooth[-1] - zp))
        cov.append(p + gain @ (cov[-1] - pp) @ gain.T)
    angles = slice(0, k, s)
    return (
        np.array([row[3][angles] for row in rows]), np.array([row[4][angles, angles] for row in rows]),
        np.array([row[5] for row in rows]), np.array(smooth[::-1])[:, angles], np.array(cov[::-1])[:, angles, angles],
    )  # fmt: skip


def offset_var(walk):
    return OFFSET_STD**2 if walk > NEVER**2 else NEVER**2


@pytest.mark.parametrize(("order", "walk"), CASES)
def test_banded_solve_equals_the_textbook(order, walk):
    world = draw(0, duration=8.0)
    log, *parts = posed(world.features, world.body, MotionModel(order, PROCESS[order], walk))
    mean, cov, cost, smooth, smooth_cov = textbook(*parts, log.chain.motion, R)
    past, all_of_it = (
        given(solve(log, initial_states(log), whole)) for whole, given in ((False, given_past), (True, given_all))
    )
    near = 1e-9 if order == 2 else 1e-8
    np.testing.assert_allclose(past.states[:, :, 0], mean, atol=near)
    np.testing.assert_allclose(all_of_it.states[:, :, 0], smooth, atol=near)
    np.testing.assert_allclose(past.cov, cov, atol=1e-9)
    np.testing.assert_allclose(all_of_it.cov, smooth_cov, atol=1e-9)
    # but for the mixture's own: outliers are rare, and here are none
    assert past.nats.sum() == pytest.approx(cost.sum(), abs=0.1)
    np.testing.assert_allclose(all_of_it.states[-1, :, 0], past.states[-1, :, 0], atol=near)


@pytest.mark.parametrize("method", ["laplace", "smoother"])
def test_an_offset_of_one_joint_leaves_the_others_as_they_are(method):
    world = draw(1, duration=10.0, encoder_hz=100.0, encoder_std=0.005)
    joints = world.features.joints
    values = joints.values + 0.3 * np.outer(joints.t > 5.0, np.array(joints.names) == "lift")
    jumped = replace(world.features, joints=replace(joints, values=values), tracks={})
    auto, on, off = (
        estimate(jumped, world.body, Estimation(method=method, bias=bias)) for bias in ("auto", "on", "off")
    )
    lift = np.array(world.body.joints) == "lift"
    # without images joints are independent: each is as if all, or none, had offsets
    assert auto.settings["order"] == on.settings["order"] == off.settings["order"]
    np.testing.assert_array_equal(np.array(auto.settings["drift"]) > 0.0, lift)
    np.testing.assert_allclose(auto.joints.values[:, lift], on.joints.values[:, lift], atol=1e-9)
    np.testing.assert_allclose(auto.joints.values[:, ~lift], off.joints.values[:, ~lift], atol=1e-9)
    assert np.abs(auto.bias.values[:, ~lift]).max() == 0.0


@pytest.mark.parametrize("method", ["laplace", "smoother"])
def test_mixture_cost_grows_with_an_outliers_distance(method):
    costs, motion = [], MotionModel(3, np.full(3, 0.3))
    for far in (0.0, 5.0, 8.0, 13.0, 21.0, 50.0, 500.0):
        world = draw(2, duration=8.0)
        values = world.features.joints.values.copy()
        values[200, 1] += far * 0.02
        features = replace(world.features, joints=replace(world.features.joints, values=values))
        log, *_ = posed(features, world.body, motion, np.full(3, 4e-4))
        costs.append(solve(log, initial_states(log), smooth=method == "smoother").forth.nats.sum())
    assert all(before <= after + 0.01 for before, after in pairwise(costs))


def test_mixture_cost_is_monotonic():
    nu = np.linspace(0.0, 70.0, 20001)
    weight, cost = inlier(nu, np.ones_like(nu), 1e-5)
    assert (np.diff(cost) >= 0.0).all() and (np.diff(weight) <= 0.0).all()
    assert cost[0] == pytest.approx(0.5 * np.log(2.0 * np.pi), abs=1e-4) and weight[0] > 0.999 and weight[-1] < 1e-9


def test_motion_order_is_chosen_by_evidence_and_recorded():
    orders, t = [], np.arange(0.0, 20.0, 0.01)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        world = draw(seed, encoder_hz=100.0)
        orders.append(estimate(world.features, world.body, Estimation(senses=ENCODERS)).settings["order"])
        acceleration = rng.normal(0.0, np.sqrt(0.5 / 0.01), (len(t), 3))
        x = np.cumsum(np.cumsum(acceleration, axis=0) * 0.01, axis=0) * 0.01
        joints = replace(world.features.joints, values=x + rng.normal(0.0, 0.003, x.shape))
        shaken = replace(world.features, joints=joints, tracks={})
        found = estimate(shaken, world.body, Estimation())
        orders.append(found.settings["order"])
        assert found.settings["nats"]["order/3"] < 0.0
    assert orders == [3, 2] * 3


def test_estimate_is_deterministic():
    world = draw(4, duration=6.0)
    asked = Estimation(method="smoother", senses=ENCODERS)
    one, two = (estimate(world.features, world.body, asked) for _ in range(2))
    assert one.joints.values.tobytes() == two.joints.values.tobytes() and one.cov.tobytes() == two.cov.tobytes()

"""The banded solve against textbook recursions in full matrices, for both orders of motion and with offsets."""

from dataclasses import dataclass, replace
from itertools import pairwise
from math import factorial

import numpy as np
import pytest

from bodylog.estimation import estimate
from bodylog.estimation.faults.screening import screened
from bodylog.estimation.inference.assemble import NEVER, START_STD, Assumed, assemble, initial_states
from bodylog.estimation.inference.beliefs import given_all, given_past
from bodylog.estimation.inference.initial_path import OFFSET_STD
from bodylog.estimation.inference.mixture import inlier
from bodylog.estimation.inference.motion_model import MotionModel
from bodylog.estimation.inference.offset_evidence import offset_score
from bodylog.estimation.inference.offsets import evidence, nats, with_walks
from bodylog.estimation.inference.row_errors import WHITE
from bodylog.estimation.inference.solver import solve
from bodylog.estimation.measurements.timeline import timeline
from bodylog.settings import Estimation
from tests.estimation.conftest import Linear, draw

ENCODERS = ("encoders",)
R, PIXEL = np.array([4e-4, 5e-4, 6e-4]), 0.16
PROCESS = {2: np.array([0.3, 0.5, 1.0]), 3: np.array([9.0, 15.0, 30.0])}
WALK = np.array([1e-4, 0.0, 1e-6])
CASES = [(2, None), (3, None), (2, WALK), (3, WALK)]


@dataclass(frozen=True)
class Erring(Linear):
    """A linear body whose model admits to a variance, px², alike everywhere."""

    blur: float = 0.0

    def predict(self, x):
        mean, jac, _ = super().predict(x)
        return mean, jac, np.full((len(x), 2), self.blur)


def posed(world, motion, encoder=R):
    found = screened(world.features, world.body, Estimation())
    line = timeline(found, None)
    start = np.array([column[np.isfinite(column)][0] for column in found.encoders.values.T])
    return assemble(found, line, start, Assumed(encoder, motion, {}, np.ones(3))), found, line, start


def textbook(found, line, start, motion, encoder, blur=0.0):
    """Means and covariances of filter and smoother at every instant, and nats: joints one after the other, then errors.

    Each row's error is a state that stays, but for new noise where the place has moved.
    """
    m, order, s = 3, motion.order, motion.states
    k = m * s + 2
    z, last, rows, seen_before = np.zeros(k), line.t[0], [], None
    z[: m * s : s] = start
    var = np.square(START_STD[:order])
    p = np.zeros((k, k))
    for j in range(m):
        own = np.append(var, [] if motion.walk is None else [offset_var(motion.walk[j])])
        p[j * s : j * s + s, j * s : j * s + s] = np.diag(own)
    p[m * s :, m * s :] = np.eye(2)
    sighting = found.sightings[0]
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
        frame = np.flatnonzero(line.sightings[0] == i)
        place = sighting.values[frame[0]] if len(frame) else None
        if place is not None and seen_before is not None:
            shared = np.exp(-np.linalg.norm(place - seen_before) / 0.5)
            left = blur / (blur + PIXEL) + PIXEL / (blur + PIXEL) * shared
            left = min(left, 1.0 - 1e-5)
            f[m * s :, m * s :] *= left
            q[m * s :, m * s :] += (1.0 - left**2) * np.eye(2)
        zp, pp = f @ z, f @ p @ f.T + q
        h, y, r = [], [], []
        row = np.flatnonzero(line.encoders == i)
        for j in range(m) if len(row) else ():
            reading = found.encoders.values[row[0], j]
            if np.isfinite(reading):
                h.append(np.zeros(k))
                h[-1][j * s] = 1.0
                if motion.walk is not None:
                    h[-1][j * s + s - 1] = 1.0
                y.append(reading)
                r.append(encoder[j])
        if place is not None:
            model = sighting.model
            cov = 0.7 * blur * correlation(model.a) + (0.3 * blur + (1.0 - WHITE) * PIXEL) * np.eye(2)
            lower = np.linalg.cholesky(cov)
            for d in range(2):
                h.append(np.zeros(k))
                h[-1][: m * s : s], h[-1][m * s :] = model.a[d], lower[d]
                y.append(place[d] - model.b[d])
                r.append(WHITE * PIXEL)
            seen_before = place
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
    angles = slice(0, m * s, s)
    return (
        np.array([row[3][angles] for row in rows]), np.array([row[4][angles, angles] for row in rows]),
        np.array([row[5] for row in rows]), np.array(smooth[::-1])[:, angles], np.array(cov[::-1])[:, angles, angles],
    )  # fmt: skip


def offset_var(walk):
    return OFFSET_STD**2 if walk > NEVER**2 else NEVER**2


def correlation(a):
    cov = a @ a.T
    return cov / np.sqrt(np.outer(np.diag(cov), np.diag(cov)))


@pytest.mark.parametrize(("order", "walk"), CASES)
@pytest.mark.parametrize("blur", [0.0, 0.5])
def test_a_linear_body_is_the_textbooks(linear_model, order, walk, blur):
    world = draw(0, duration=8.0, model=Erring(linear_model.a, linear_model.b, blur=blur))
    motion = MotionModel(order, PROCESS[order], None if walk is None else np.maximum(walk, NEVER**2))
    log, *parts = posed(world, motion)
    mean, cov, cost, smooth, smooth_cov = textbook(*parts, motion, R, blur)
    filtered = solve(log, initial_states(log), smooth=False)
    past, all_of_it = given_past(filtered), given_all(solve(log, initial_states(log), smooth=True))
    near = 1e-9 if order == 2 else 1e-8
    np.testing.assert_allclose(past.states[:, :, 0], mean, atol=near)
    np.testing.assert_allclose(all_of_it.states[:, :, 0], smooth, atol=near)
    np.testing.assert_allclose(past.cov, cov, atol=1e-9)
    np.testing.assert_allclose(all_of_it.cov, smooth_cov, atol=1e-9)
    # but for the mixture's own: outliers are rare, and here are none
    assert past.nats.sum() == pytest.approx(cost.sum(), abs=0.1)
    np.testing.assert_allclose(all_of_it.states[-1, :, 0], past.states[-1, :, 0], atol=near)
    assert evidence(filtered) == pytest.approx(cost.sum(), abs=1e-4)


@pytest.mark.parametrize("order", [2, 3])
def test_what_an_offset_wins_to_first_order_is_what_it_wins(order):
    world = draw(1, duration=16.0)
    joints = world.features.joints
    off = joints.values + 0.01 * (joints.t > 8.0)[:, None] * (np.array(joints.names) == "lift")
    world.features = replace(world.features, joints=replace(joints, values=off))
    log, *_ = posed(world, MotionModel(order, PROCESS[order] / 100.0), np.full(3, 4e-4))
    without = solve(log, initial_states(log), smooth=True)
    score = offset_score(without)
    for joint in range(3):
        walk = np.where(np.arange(3) == joint, 1e-5, 0.0)
        won = evidence(without) - evidence(with_walks(without, walk, smooth=True))
        assert score.won(joint, 1e-5)[0] == pytest.approx(won, abs=1.0 + 0.15 * abs(won))


@pytest.mark.parametrize("method", ["laplace", "smoother"])
@pytest.mark.parametrize("sense", ["encoders", "effector"])
def test_an_outlier_costs_more_the_farther_out_it_is(method, sense):
    costs = []
    # nearer ones, hardly distinct from inliers, mislead a filter for an image or two
    for far in (0.0, 5.0, 8.0, 13.0, 21.0, 50.0, 500.0):
        world = draw(2, duration=8.0)
        joints, track = world.features.joints, world.features.tracks["effector"]
        values, places = joints.values.copy(), track.values.copy()
        if sense == "encoders":
            values[200, 1] += far * 0.02
        else:
            places[50, 0] += far * 2.0
        tracks = {"effector": replace(track, values=places)}
        features = replace(world.features, joints=replace(joints, values=values), tracks=tracks)
        monkey = assembled(features, world.body)
        costs.append(nats(solve(monkey, initial_states(monkey), smooth=method == "smoother")))
    assert all(before <= after + 0.01 for before, after in pairwise(costs))


def assembled(features, body):
    found = screened(features, body, Estimation())
    return assemble(
        found, timeline(found, None), found.first,
        Assumed(np.full(3, 4e-4), MotionModel(3, np.full(3, 0.3)), {}, np.ones(3)),
    )  # fmt: skip


def test_the_mixture_is_a_proper_cost():
    d2 = np.linspace(0.0, 5000.0, 20001)
    weight, cost = inlier(d2, np.zeros_like(d2), 2, 1e-5)
    assert (np.diff(cost) >= 0.0).all() and (np.diff(weight) <= 0.0).all()
    assert cost[0] == pytest.approx(np.log(2.0 * np.pi), abs=1e-4) and weight[0] > 0.999 and weight[-1] < 1e-9


def test_the_order_of_motion_is_chosen_by_evidence_and_stands_in_the_settings():
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


def test_the_order_of_tracks_does_not_show():
    world = draw(5, duration=8.0)
    track, body = world.features.tracks["effector"], world.body
    other = replace(track, values=track.values + np.random.default_rng(0).normal(0.0, 0.4, track.values.shape))
    both = {"effector": track, "other": other}
    body = replace(body, senses=dict.fromkeys(both, body.senses["effector"]))
    logs = [assembled(replace(world.features, tracks=tracks), body) for tracks in (both, dict(reversed(both.items())))]
    one, two = (given_all(solve(log, initial_states(log), smooth=True)) for log in logs)
    np.testing.assert_array_equal(one.states, two.states)
    np.testing.assert_array_equal(one.cov, two.cov)


def test_two_estimates_are_the_same_bytes():
    world = draw(4, duration=6.0)
    asked = Estimation(method="smoother", senses=ENCODERS)
    one, two = (estimate(world.features, world.body, asked) for _ in range(2))
    assert one.joints.values.tobytes() == two.joints.values.tobytes() and one.cov.tobytes() == two.cov.tobytes()

"""Landmarks on links: derivatives, links chosen, camera and delay found, and how sure that is."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.errors import ModelError
from bodylog.kinematics import urdf
from bodylog.kinematics.camera import project_points
from bodylog.kinematics.joint_motion import CurveError, JointCurve, curve_through_samples
from bodylog.kinematics.landmark_adjustment import (
    Landmarks,
    PlacePrior,
    adjust_landmarks,
    assign_pieces,
    reduce_normal,
    whiten_back,
    whiten_residuals,
)
from bodylog.kinematics.landmark_errors import unknowns_covariance
from bodylog.kinematics.landmark_fit import (
    LandmarkFit,
    build_model,
    choose_pieces,
    search_delay,
    staged_fit,
)
from bodylog.kinematics.landmarks import LandmarkBelief, LandmarkModel, join_landmark_tracks
from bodylog.kinematics.links import FREE_LENS, Space
from tests.kinematics.landmark_arm import ARM, JOINTS, LENS, model, motion, seen, truth


def test_derivatives_are_those_of_differences():
    built = model([motion(1)])
    phi = truth(built, 0.05, 0.03)
    phi[built.rig.of_joints] = [0.02, -0.03, 0.01, 0.04]
    part, body = seen(built, phi, 2, pieces=8)
    places = np.array([built.bodies[b].centre + 0.05 for b in body])
    exact = built.predict(phi, part, body, places)
    for k in range(len(phi)):
        step = 1e-6 * (np.arange(len(phi)) == k)
        above, below = (built.predict(phi + way * step, part, body, places).image for way in (1, -1))
        np.testing.assert_allclose(exact.by_shared[:, :, k], (above - below) / 2e-6, rtol=2e-4, atol=2e-3)
    for k in range(3):
        step = 1e-6 * (np.arange(3) == k)
        above, below = (built.predict(phi, part, body, places + way * step).image for way in (1, -1))
        np.testing.assert_allclose(exact.by_place[:, :, k], (above - below) / 2e-6, rtol=2e-4, atol=2e-3)


def test_elimination_equals_the_whole_system():
    built = model([motion(1)])
    phi = truth(built)
    part, body = seen(built, phi, 3, pieces=6)
    places = np.array([built.bodies[b].centre for b in body])
    few = Landmarks(body, places)
    reduced = reduce_normal(built, phi, part, few)
    predicted = built.predict(phi, part, body, places)
    shared, weight = len(phi), np.repeat(reduced.weight, 2)
    whole = np.zeros((2 * len(part.piece), shared + 3 * part.count))
    whole[:, :shared] = whiten_residuals(predicted.by_shared, part, 0.8).reshape(-1, shared)
    own = whiten_residuals(predicted.by_place, part, 0.8).reshape(-1, 3)
    for row, number in enumerate(np.repeat(part.piece, 2)):
        whole[row, shared + 3 * number : shared + 3 * number + 3] = own[row]
    sizes = np.array([built.bodies[b].size for b in body])
    prior = np.concatenate([built.prior[1] ** -2.0, np.repeat(sizes, 3) ** -2.0])
    matrix = whole.T @ (weight[:, None] * whole) + np.diag(prior)
    schur = np.linalg.inv(np.linalg.inv(matrix)[:shared, :shared])
    np.testing.assert_allclose(reduced.matrix, schur, rtol=1e-5, atol=1e-5 * np.abs(schur).max())


def test_each_piece_is_found_on_its_link():
    built = model([motion(4)])
    phi = truth(built)
    part, body = seen(built, phi, 5)
    chosen = assign_pieces(built, phi, part)
    assert (chosen.body == body).mean() > 0.9
    assert np.median(chosen.error) < 0.6


@pytest.mark.parametrize("seed", range(2))
def test_camera_and_delay_are_found_within_their_errors(seed):
    built = model([motion(10 + seed)])
    phi = truth(built, delay=0.06)
    part, _ = seen(built, phi, 20 + seed)
    start, _ = search_delay(built, built.prior[0].copy(), part.thinned(4))
    found = staged_fit(built, start, part.thinned(2))
    assert found is not None
    std = np.sqrt(np.diag(unknowns_covariance(found)))
    delay = built.of_delays.start
    assert found.phi[delay] == pytest.approx(0.06, abs=0.003)
    assert (np.abs(found.phi - phi) < 3.5 * std)[:7].all()
    assert len(found.used) > 0.8 * part.count


def test_unknowns_that_no_landmark_shows_keep_their_priors():
    built = model([motion(3)])
    phi = truth(built)
    truly, of_body = seen(built, phi, 31, pieces=60)
    first = np.flatnonzero(of_body == of_body.min())
    part, body = truly.take(first), of_body[first]
    places = np.array([built.bodies[b].centre for b in body])
    free = np.ones(len(phi), bool)
    found, placed, reduced = adjust_landmarks(built, phi, part, Landmarks(body, places), free)
    fit = LandmarkFit(built, found, free, part, first, placed, reduced)
    std = np.sqrt(np.diag(unknowns_covariance(fit)))
    predicted = built.predict(found, part, body, placed.places)
    unseen = np.flatnonzero(np.abs(predicted.by_joints).max(axis=(0, 1)) == 0.0)
    assert len(unseen)
    zeros = np.arange(built.rig.of_joints.start, built.rig.of_joints.stop)
    np.testing.assert_allclose(std[zeros[unseen]], built.prior[1][zeros[unseen]], rtol=1e-6)


def test_first_joint_before_a_camera_of_unknown_pose_keeps_its_prior():
    """A turned camera sees the same: what the landmarks tell of this zero rounds to a little more or less than nothing."""
    plain = model([motion(3)])
    space = Space(urdf.parse_urdf(ARM, "arm.urdf"), JOINTS, {}, np.radians(5.0))
    anywhere = replace(plain.rig.cameras[0], doubt=np.concatenate([[300.0] * 3, [30.0] * 3, FREE_LENS]))
    built = build_model(space, anywhere, plain.motions, np.radians(5.0))
    phi = truth(built)
    pan = built.rig.of_joints.start
    for draw in range(12):
        part, body = seen(built, phi, 31 + draw, pieces=60, noise=0.0)
        places = np.array([built.bodies[b].centre + 0.05 for b in body])
        rng = np.random.default_rng(draw)
        uv = built.predict(phi, part, body, places).image
        part = replace(part, uv=uv + 0.3 * rng.standard_normal(uv.shape))
        landmarks = Landmarks(body, places)
        reduced = reduce_normal(built, phi, part, landmarks)
        fit = LandmarkFit(built, phi, np.ones(len(phi), bool), part, np.arange(part.count), landmarks, reduced)
        assert np.sqrt(unknowns_covariance(fit)[pan, pan]) == pytest.approx(np.radians(5.0), rel=0.01)


def smoothed_with_errors(real: JointCurve, error: CurveError, seed: int) -> JointCurve:
    """A motion with errors of this kind drawn onto its angles."""
    rng = np.random.default_rng(seed)
    lags = real.t[:, None] - real.t
    drawn = [
        np.linalg.cholesky(error.correlation(joint, lags) + 1e-6 * np.eye(len(real.t))) @ rng.standard_normal(len(real.t))
        for joint in range(real.q.shape[1])
    ]
    return curve_through_samples(real.t, real.q + error.std * np.stack(drawn, axis=1), error)


def test_error_bar_of_a_delay_holds_the_errors_of_smoothed_joints():
    """A few mrad of smoothed noise at slow motion shift a delay by more than corners do."""
    full = motion(70)
    real = curve_through_samples(full.t[::10], full.q[::10])
    truly = model([real])
    phi = truth(truly)
    delay = truly.of_delays.start
    part, body = seen(truly, phi, 71, pieces=40)
    places = np.array([truly.bodies[b].centre for b in body])
    free = np.arange(len(phi)) == delay
    free[:7] = True
    squares = np.empty((6, 2))
    for draw in range(6):
        error = CurveError(np.full(4, 0.006), np.full(4, 6.0))
        built = model([smoothed_with_errors(real, error, draw)])
        found, placed, reduced = adjust_landmarks(built, phi, part, Landmarks(body, places), free, steps=5)
        for column, one in enumerate((error, None)):
            stated = replace(built, motions=(replace(built.motions[0], error=one),))
            fit = LandmarkFit(stated, found, free, part, np.arange(40), placed, reduced)
            squares[draw, column] = found[delay] ** 2 / unknowns_covariance(fit)[delay, delay]
    held, without = squares.mean(axis=0)
    assert held < 2.0
    assert without > 2.0 * held


def test_error_bar_of_a_delay_holds_a_camera_whose_clock_drifts():
    """A recorder's stamps of a slower camera run 0 to 33 ms late, over and over: of six seconds no noise tells that."""
    squares, stds = [], []
    for draw in range(10):
        built = model([motion(90 + draw)])
        phi = truth(built)
        delay = built.of_delays.start
        whole, of_whole = seen(built, phi, 95 + draw, pieces=90)
        early = np.flatnonzero(whole.t[whole.begins] < 5.0)
        exact, body = whole.take(early), of_whole[early]
        part = replace(exact, t=exact.t + 0.033 * ((exact.t / 5.5 + draw / 10.0) % 1.0 - 0.5))
        places = np.array([built.bodies[b].centre for b in body])
        free = np.arange(len(phi)) == delay
        free[:7] = True
        found, placed, reduced = adjust_landmarks(built, phi, part, Landmarks(body, places), free, steps=5)
        fit = LandmarkFit(built, found, free, part, np.arange(len(early)), placed, reduced)
        std = np.sqrt(unknowns_covariance(fit)[delay, delay])
        squares.append((found[delay] / std) ** 2)
        stds.append(std)
    assert np.mean(squares) < 1.2  # a sandwich of so few blocks is too sure: 1.4
    assert max(stds) < 0.01


def test_innovations_are_weighed_back_by_the_transpose():
    built = model([motion(80)])
    part, _ = seen(built, truth(built), 81, pieces=4)
    rng = np.random.default_rng(5)
    residual, innovation = rng.standard_normal((2, len(part.t), 2))
    forth = (innovation * whiten_residuals(residual, part, 0.8)).sum()
    back = (residual * whiten_back(innovation, part, 0.8)).sum()
    assert forth == pytest.approx(back, rel=1e-12)


def test_joints_of_another_time_explain_little():
    built = model([motion(30)])
    part, _ = seen(built, truth(built), 31)
    other = LandmarkModel(built.rig, built.bodies, (motion(99),))
    found = staged_fit(other, built.prior[0].copy(), part.thinned(2))
    assert found is None or len(found.used) < 0.3 * part.count


def test_adjustment_lessens_the_cost():
    built = model([motion(40)])
    phi = truth(built)
    part, body = seen(built, phi, 41, pieces=40)
    places = assign_pieces(built, phi, part).places
    start = Landmarks(body, places)
    free = np.arange(len(phi)) < 7
    moved, after, reduced = adjust_landmarks(built, built.prior[0].copy(), part, start, free)
    assert reduced.cost < reduce_normal(built, built.prior[0], part, start).cost
    assert LandmarkFit(built, moved, free, part, np.arange(40), after, reduced).error_px < 1.0


def test_logs_are_joined_with_a_delay_of_their_own():
    built = model([motion(50), motion(51)])
    parts = [seen(model([m]), truth(model([m])), 52 + k, pieces=10)[0] for k, m in enumerate(built.motions)]
    both = join_landmark_tracks([(part.piece, part.t, part.uv) for part in parts], 480.0)
    assert both.count == 20
    assert (np.bincount(both.log) == [240, 240]).all()
    assert built.of_delays.stop - built.of_delays.start == 2


def test_more_pairs_of_links_than_can_be_compared_are_refused():
    """A hand of 80 fingers: any two of its links may carry camera and marker."""
    links = "".join(f'<link name="tip{k}"/>' for k in range(80))
    joint = '<joint name="j{0}" type="revolute"><parent link="palm"/><child link="tip{0}"/><axis xyz="0 0 1"/></joint>'
    text = f'<robot name="hand"><link name="palm"/>{links}{"".join(joint.format(k) for k in range(80))}</robot>'
    space = Space(urdf.parse_urdf(text, "hand.urdf"), tuple(f"j{k}" for k in range(80)), {}, np.radians(5.0))
    with pytest.raises(ModelError, match=r"hand.urdf: 6561 pairs of links .*, as 80 of its joints move; at most 4096 "):
        list(space.pairs(None, None))
    assert len([pair for some in space.pairs("palm", None) for pair in some]) == 80


def test_two_logs_find_one_camera_and_a_delay_each():
    built = model([motion(60), motion(61)])
    delays = [0.02, 0.11]
    ones = [model([one]) for one in built.motions]
    parts = [seen(one, truth(one, delay), 62 + k)[0] for k, (one, delay) in enumerate(zip(ones, delays, strict=True))]
    both = join_landmark_tracks([(part.piece, part.t, part.uv) for part in parts], 480.0)
    start, _ = search_delay(built, built.prior[0].copy(), both.thinned(4))
    np.testing.assert_allclose(start[built.of_delays], delays, atol=0.03)
    chosen = choose_pieces(both, 60)
    assert (np.bincount(both.log[both.begins][chosen]) == 60).all()
    found = staged_fit(built, start, both.take(chosen).thinned(2))
    assert found is not None
    np.testing.assert_allclose(found.phi[built.of_delays], delays, atol=0.003)
    std = np.sqrt(np.diag(unknowns_covariance(found)))
    assert abs(found.phi[6] - LENS[0]) < 3.0 * std[6]


def test_belief_of_earlier_logs_is_a_prior():
    built = model([motion(70)])
    phi = truth(built)
    part, body = seen(built, phi, 71, pieces=30)
    mean, std = built.prior
    same = replace(built, belief=LandmarkBelief(mean, np.diag(std**2)))
    few = Landmarks(body, assign_pieces(built, phi, part).places)
    plain, believed = (reduce_normal(one, phi, part, few) for one in (built, same))
    np.testing.assert_allclose(believed.matrix, plain.matrix, rtol=1e-6, atol=1e-6 * np.abs(plain.matrix).max())
    assert believed.cost == pytest.approx(plain.cost)
    sure = replace(built, belief=LandmarkBelief(phi, np.diag((1e-4 * std) ** 2)))
    held, _, _ = adjust_landmarks(sure, phi, part, few, np.ones(len(phi), bool))
    assert (np.abs(held - phi) < 1e-3 * std).all()


def test_a_camera_moved_between_logs_has_a_placement_in_each():
    built = replace(model([motion(80), motion(81)]), placements=(1, 0))
    phi = np.concatenate([truth(model([motion(80), motion(81)]), 0.05, 0.03), [0.02, -0.01, 0.03, 0.01, -0.02, 0.01]])
    one, body = seen(model([built.motions[0]]), truth(model([built.motions[0]])), 82, pieces=8)
    part = join_landmark_tracks([(one.piece, one.t, one.uv)] * 2, 480.0)
    bodies = np.concatenate([body, body])
    places = np.array([built.bodies[b].centre + 0.05 for b in bodies])
    exact = built.predict(phi, part, bodies, places)
    for k in range(len(phi)):
        step = 1e-6 * (np.arange(len(phi)) == k)
        above, below = (built.predict(phi + way * step, part, bodies, places).image for way in (1, -1))
        np.testing.assert_allclose(exact.by_shared[:, :, k], (above - below) / 2e-6, rtol=2e-4, atol=2e-3)
    shown = replace(part, uv=exact.image)
    rotation, place = built.frames(phi, built.joints_at(phi, part)[0], int(bodies[0]), part.log)
    inside = np.einsum("nij,nj->ni", rotation, places[part.piece]) + place
    on_body = bodies[part.piece] == bodies[0]
    np.testing.assert_allclose(project_points(inside[on_body], phi[6:12])[0], exact.image[on_body], atol=1e-6)
    start = phi.copy()
    start[built.of_moves] = 0.0
    free = np.zeros(len(phi), bool)
    free[built.of_moves] = True
    certain = np.stack([1e6 * np.eye(3)] * len(places))
    prior = PlacePrior(places, certain, np.zeros((len(places), 3, len(phi))), phi)
    sure = Landmarks(bodies, places, prior)
    found, _, _ = adjust_landmarks(built, start, shown, sure, free)
    np.testing.assert_allclose(found[built.of_moves], phi[built.of_moves], atol=2e-3)

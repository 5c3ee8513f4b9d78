"""A map is a prior of places: judging by it is as one adjustment of both logs, and views are those that look alike."""

from dataclasses import replace

import numpy as np

from bodylog.body_model import LandmarkMap
from bodylog.kinematics.landmark_adjustment import Landmarks, reduce_normal
from bodylog.kinematics.landmark_map import nearest_views, place_prior, predict_landmarks, view_maps
from bodylog.kinematics.landmarks import LandmarkBelief, LandmarkModel, LandmarkSightings
from tests.kinematics.landmark_arm import model, motion, seen, truth


def with_changes(built: LandmarkModel) -> LandmarkModel:
    mean, std = built.prior
    more = 6 + len(built.rig.joints)
    belief = LandmarkBelief(np.concatenate([mean, np.zeros(more)]), np.diag(np.concatenate([std, np.full(more, 0.05)]) ** 2))
    return replace(built, belief=belief, changes=True)


def test_changes_move_what_the_unknowns_move():
    plain = model([motion(1)])
    built = with_changes(plain)
    phi = np.concatenate([truth(plain, 0.05, 0.03), np.full(6, 0.01), [0.02, -0.03, 0.01, 0.04]])
    moved = truth(plain, 0.05, 0.03)
    moved[:6] += 0.01
    moved[plain.rig.of_joints] += [0.02, -0.03, 0.01, 0.04]
    part, body = seen(plain, truth(plain), 2, pieces=8)
    places = np.array([built.bodies[b].centre + 0.05 for b in body])
    exact = built.predict(phi, part, body, places)
    np.testing.assert_allclose(exact.image, plain.predict(moved, part, body, places).image, atol=1e-9)
    assert built.of_changes.stop == len(phi)
    for k in range(built.of_row_time + 1, len(phi)):
        step = 1e-6 * (np.arange(len(phi)) == k)
        above, below = (built.predict(phi + way * step, part, body, places).image for way in (1, -1))
        np.testing.assert_allclose(exact.by_shared[:, :, k], (above - below) / 2e-6, rtol=2e-4, atol=2e-3)


def test_map_as_a_prior_is_one_adjustment_of_both_logs():
    """Normal equations of two logs with places eliminated = those of the second with the first's map as prior."""
    both = model([motion(1), motion(2)])
    phi = both.prior[0].copy()
    first, body = seen(model([motion(1)]), truth(model([motion(1)])), 3, pieces=9)
    later = np.arange(len(first.t)) % 24 >= 12
    second = replace(first, log=np.ones(len(first.t), int))
    places = np.array([both.bodies[b].centre for b in body])
    count = first.count

    def rows(part: LandmarkSightings, chosen: np.ndarray) -> LandmarkSightings:
        return LandmarkSightings(part.piece[chosen], part.log[chosen], part.t[chosen], part.uv[chosen], part.height)

    early, late = rows(first, ~later), rows(second, later)
    order = np.lexsort((np.r_[early.t, late.t], np.r_[early.log, late.log], np.r_[early.piece, late.piece]))
    joined = LandmarkSightings(
        *(np.concatenate([getattr(early, name), getattr(late, name)])[order] for name in ("piece", "log", "t", "uv")),
        first.height,
    )
    whole = reduce_normal(both, phi, joined, Landmarks(body, places))
    alone = reduce_normal(both, phi, early, Landmarks(body, places))
    moved = places + np.linalg.solve(alone.place_matrix, alone.place_pull[..., None])[..., 0]
    slopes = -np.linalg.solve(alone.place_matrix, alone.cross)
    known = LandmarkMap(body, moved, alone.place_matrix, slopes, np.arange(count), np.zeros(0), np.zeros(0))
    prior = place_prior(known, np.arange(len(phi)), phi, phi)
    after = reduce_normal(both, phi, late, Landmarks(body, places, prior))
    summed = after.matrix - both.prior_precision + alone.matrix
    np.testing.assert_allclose(summed, whole.matrix, rtol=1e-6, atol=1e-6 * np.abs(whole.matrix).max())
    np.testing.assert_allclose(after.pull + alone.pull, whole.pull, atol=1e-6 * np.abs(whole.pull).max())


def test_landmarks_are_foretold_where_they_are_exposed():
    built = model([motion(4)])
    phi = truth(built, 0.04, 0.06)
    part, body = seen(built, phi, 5, pieces=6, noise=0.0)
    rng = np.random.default_rng(5)
    rng.integers(1, len(built.bodies), 6)
    places = np.array([built.bodies[b].centre + 0.35 * built.bodies[b].size * rng.standard_normal(3) for b in body])
    for piece in range(part.count):
        rows = part.piece == piece
        found = predict_landmarks(built, phi, Landmarks(body, places), part.t[rows], 0, part.height)
        np.testing.assert_allclose(found.image[piece], part.uv[rows], atol=0.3)
        assert found.front[piece].all()


def test_view_is_the_one_that_looks_from_nearest_by():
    straight = np.array([[400.0, 0.0, 0.0], [0.0, 400.0, 0.0]])
    aside = np.array([[0.0, 0.0, 400.0], [0.0, 400.0, 0.0]])
    empty = np.zeros(0)
    known = LandmarkMap(
        np.zeros(2, int), np.zeros((2, 3)), empty, empty, np.array([0, 0, 1]), empty, np.stack([aside, straight, aside])
    )
    views, facing = nearest_views(known, np.stack([2.0 * straight, straight]))
    assert views.tolist() == [1, 2]
    np.testing.assert_allclose(facing, [1.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(view_maps(2.0 * straight, straight), 2.0 * np.eye(2), atol=1e-9)

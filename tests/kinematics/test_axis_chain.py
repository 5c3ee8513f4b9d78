"""Chains of unknown axes: derivatives against differences, both ways to predict, and the search."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from bodylog.kinematics import axis_search
from bodylog.kinematics.axis_instant import compile_axes
from bodylog.kinematics.axis_search import AxisSightings, find_axes
from bodylog.kinematics.rotations import rotation_from_vector
from tests.body.conftest import project
from tests.kinematics.axis_chains import LENS, LENSES, draw_chain
from tests.seeds import first_of

HOME = np.array([0.0, 0.3, 0.6])
LENS_STD = np.array([0.4, 0.02, 30.0, 30.0, 0.2, 0.2])


@LENSES
@pytest.mark.parametrize("seed", range(3))
def test_derivatives_are_those_of_differences(lens, seed):
    chain = draw_chain(seed, 4, lens)
    q = np.random.default_rng(seed).normal(0.0, 0.4, (6, 4))
    _, slope, design = chain.see(q)
    step = 1e-6
    for m, way in enumerate(step * np.eye(4)):
        found = (chain.see(q + way)[0] - chain.see(q - way)[0]) / (2.0 * step)
        assert np.allclose(slope[..., m], found, rtol=1e-6, atol=1e-5)
    for p, way in enumerate(step * np.eye(chain.unknown_count)):
        found = (chain.move_axes(way).see(q)[0] - chain.move_axes(-way).see(q)[0]) / (2.0 * step)
        assert np.allclose(design[..., p], found, rtol=1e-6, atol=1e-5)


@LENSES
@pytest.mark.parametrize("seed", range(3))
def test_steps_that_show_as_motions_of_camera_and_marker_are_those_of_differences(lens, seed):
    """Far from where they were learned: derivatives are by motions that add up."""
    chain = draw_chain(seed, 4, lens)
    draw = np.random.default_rng(seed)
    q = draw.normal(0.0, 0.4, (6, 4))
    camera, marker = draw.normal(0.0, 0.2, 6), draw.normal(0.0, 0.1, 3)
    moved, *steps = chain.move_poses(camera, marker)
    design = moved.see(q)[2]
    step = 1e-6
    for size, by, add in ((6, steps[0], lambda w: (camera + w, marker)), (3, steps[1], lambda w: (camera, marker + w))):
        for k, way in enumerate(step * np.eye(size)):
            above, below = (chain.move_poses(*add(one))[0].see(q)[0] for one in (way, -way))
            assert np.allclose(design @ by[:, k], (above - below) / (2.0 * step), rtol=1e-6, atol=1e-5)


def test_a_moved_tracker_sees_the_same_points_from_elsewhere():
    chain = draw_chain(4, 3, np.zeros(0))
    q = np.random.default_rng(4).normal(0.0, 0.4, (10, 3))
    camera = np.array([0.1, -0.2, 0.05, 0.3, -0.2, 0.1])
    there = chain.see(q)[0] * 1e-3 @ rotation_from_vector(camera[3:]).T + camera[:3]
    assert np.allclose(1e3 * there, chain.move_poses(camera, np.zeros(3))[0].see(q)[0])


@LENSES
def test_one_posture_is_predicted_as_many(lens):
    chain = draw_chain(5, 3, lens)
    q = np.random.default_rng(5).normal(0.0, 0.4, (10, 3))
    at = compile_axes(chain)
    for one, many in zip(zip(*(at(x) for x in q), strict=True), chain.see(q), strict=True):
        assert np.allclose(one, many, rtol=1e-12, atol=1e-9)


def test_moved_frames_stay_rotations():
    chain = draw_chain(1, 3, LENS)
    for seed in range(20):
        chain = chain.move_axes(np.random.default_rng(seed).normal(0.0, 1.0, chain.unknown_count))
    assert np.allclose(chain.frames @ chain.frames.transpose(0, 2, 1), np.eye(3), atol=1e-12)


def _sightings(seed: int, order: tuple[int, ...], pixel: float = 0.3) -> AxisSightings:
    draw = np.random.default_rng(seed)
    q = draw.uniform(-0.5, 0.5, (150, 3)) + HOME
    y = project(q) + draw.normal(0.0, pixel, (150, 2))
    return AxisSightings(q[:, order], y, np.full(y.shape, pixel), LENS, LENS_STD)


@pytest.mark.parametrize(("order",), first_of(2, [(one,) for one in permutations(range(3))][::-1]))
def test_axes_are_found_in_whatever_order_the_log_names_the_joints(order):
    chain = find_axes(_sightings(sum(order), order), 0)
    q = np.random.default_rng(9).uniform(-0.9, 0.9, (300, 3)) + HOME
    away = chain.see(q[:, order])[0] - project(q)
    assert np.sqrt(np.square(away).mean()) < 1.0
    assert [order[m] for m in chain.order] == [0, 1, 2]


def test_a_known_chain_is_found_again_before_others_are_tried(monkeypatch):
    known = find_axes(_sightings(0, (0, 1, 2)), 0)
    moved = known.move_axes(0.05 * np.random.default_rng(1).normal(size=known.unknown_count))
    data = _sightings(0, (0, 1, 2))
    monkeypatch.delattr(axis_search, "_draw_chain")
    again = find_axes(data, 7, moved)
    assert np.allclose(again.see(data.q)[0], known.see(data.q)[0], atol=0.01)


def test_points_in_space_tell_axes_too():
    draw = np.random.default_rng(3)
    true = replace(draw_chain(3, 3, np.zeros(0)), order=np.arange(3))
    q = draw.uniform(-0.6, 0.8, (150, 3))
    y = true.see(q)[0] + draw.normal(0.0, 0.3, (150, 3))
    found = find_axes(AxisSightings(q, y, np.full(y.shape, 0.3), np.zeros(0), np.zeros(0)), 0)
    far = draw.uniform(-1.2, 1.4, (200, 3))
    assert np.sqrt(np.square(found.see(far)[0] - true.see(far)[0]).mean()) < 1.0


LIMBS = {
    "base to tip": (0, 1, 2, 3, 4),
    "tip to base": (4, 3, 2, 1, 0),
    "by the alphabet": (2, 1, 0, 3, 4),
    "head, then arm": (1, 0, 2, 3, 4),
    "arm, then head": (4, 3, 0, 1, 2),
}
"""The way from camera to marker in the log's joints."""


@pytest.mark.parametrize("way", LIMBS.values(), ids=list(LIMBS))
def test_orders_of_limbs_are_tried_once(way):
    orders = list(axis_search._likely_orders(5))
    assert len(set(orders)) == len(orders) and all(sorted(one) == list(range(5)) for one in orders)
    assert way in orders


@pytest.mark.parametrize(("way",), first_of(1, [(LIMBS["head, then arm"],), ((1, 3, 0, 2),)]), ids=["of limbs", "of no limbs"])
def test_axes_of_more_joints_are_found(way):
    joints = len(way)
    true = replace(draw_chain(2, joints, LENS), order=np.array(way), middle=np.zeros(joints))
    draw = np.random.default_rng(2)
    q = draw.uniform(-0.5, 0.5, (300, joints))
    y = true.see(q)[0] + draw.normal(0.0, 0.3, (300, 2))
    found = find_axes(AxisSightings(q, y, np.full(y.shape, 0.3), LENS, LENS_STD), 0)
    assert tuple(found.order) == way
    far = draw.uniform(-0.8, 0.8, (300, joints))
    away = found.see(far)[0] - true.see(far)[0]
    assert np.median(np.abs(away)) < 1.0

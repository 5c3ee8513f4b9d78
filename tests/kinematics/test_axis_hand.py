"""What a weight does to arms of found axes, against differences."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.kinematics.axis_hand import HAND_LENGTH, CameraHand, MarkerHand
from bodylog.kinematics.rotations import rotation_from_vector
from tests.kinematics.axis_chains import LENSES, draw_chain

STEP = 1e-6


def _postures(seed, count=5):
    return np.random.default_rng(seed).normal(0.0, 0.4, (count, 4))


def _locate_camera(chain, q):
    """The camera in the axes of what stands (N,3)."""
    seen = chain.place_axes(q)
    shift = seen.marker - seen.rotation @ chain.place
    return -(seen.rotation.swapaxes(1, 2) @ shift[..., None])[..., 0]


@LENSES
@pytest.mark.parametrize("seed", range(3))
def test_levers_are_how_far_joints_move_what_the_arm_holds(lens, seed):
    chain = draw_chain(seed, 4, lens)
    q = _postures(seed)
    np.testing.assert_allclose(chain.project_into_image(chain.place_axes(q).marker)[0], chain.see(q)[0], atol=1e-9)
    places = {MarkerHand: lambda q: chain.place_axes(q).marker, CameraHand: lambda q: -_locate_camera(chain, q)}
    for kind, place in places.items():
        levers = kind(chain).measure_levers(q)[..., :3]
        for joint, way in enumerate(STEP * np.eye(4)):
            moved = (place(q + way) - place(q - way)) / (2.0 * STEP)
            np.testing.assert_allclose(levers[:, joint], moved, atol=1e-7)


def test_levers_of_links_are_how_far_joints_move_the_next_axis():
    chain = draw_chain(3, 4, np.zeros(0))
    q = _postures(3)
    seen = chain.place_axes(q)
    ahead, own = seen.meet_next()
    apart = ahead - own
    for axes in (seen.axes[:, 1:], seen.axes[:, :-1]):
        np.testing.assert_allclose(np.einsum("nki,nki->nk", apart, axes), 0.0, atol=1e-12)
    marker = MarkerHand(chain).measure_levers(q)[..., 3:]
    camera = CameraHand(chain).measure_levers(q)[..., 3:]
    assert not marker[:, chain.order[-1]].any() and not camera[:, chain.order[0]].any()
    moved = np.cross(seen.axes[:, 1], ahead[:, 1] - seen.points[:, 1])
    np.testing.assert_allclose(marker[:, chain.order[1]], moved, atol=1e-12)
    moved = np.cross(seen.axes[:, 1], own[:, 0] - seen.points[:, 1])[:, None] @ seen.rotation
    np.testing.assert_allclose(camera[:, chain.order[1]], moved[:, 0], atol=1e-12)


def test_axes_that_are_parallel_meet_nowhere_far():
    chain = draw_chain(5, 4, np.zeros(0))
    frames = np.repeat(chain.frames[:1], 4, axis=0)
    frames[1:] = frames[1:] @ rotation_from_vector(np.array([1e-9, 0.0, 0.0])).T
    for points in replace(chain, frames=frames).place_axes(_postures(5)).meet_next():
        assert np.abs(points).max() < 10.0


@LENSES
def test_what_a_hand_gives_way_by_shows_in_images(lens):
    chain = draw_chain(7, 4, lens)
    q = _postures(7)
    shown, moves = MarkerHand(chain).show_still_joints(q)
    assert shown.shape[2] == moves.shape[1] == len(MarkerHand(chain).still_joints)
    seen = chain.place_axes(q)
    for k in range(moves.shape[1]):
        image = [chain.project_into_image(seen.marker + step * moves[:, k])[0] for step in (STEP, -STEP)]
        np.testing.assert_allclose(shown[..., k], (image[0] - image[1]) / (2.0 * STEP), rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(moves[:, k], axis=1), HAND_LENGTH)
    shown, moves = CameraHand(chain).show_still_joints(q)
    assert shown.shape[2] == moves.shape[1] == len(CameraHand(chain).still_joints) == 9
    for k in range(9):
        turn = STEP * np.eye(3)[k // 3]
        image = [chain.project_into_image(seen.marker @ rotation_from_vector(sign * turn))[0] for sign in (1.0, -1.0)]
        np.testing.assert_allclose(shown[..., k], (image[0] - image[1]) / (2.0 * STEP), rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(moves[:, k], HAND_LENGTH * seen.rotation[:, k % 3])

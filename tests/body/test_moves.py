"""A board or a camera that moved between two logs has a placement in each; where nothing moved, there is one."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog import body
from bodylog.body import storage as files
from bodylog.body.kinematic.learn import learn_kinematics
from bodylog.body.kinematic.placements import calibration_of_body
from bodylog.errors import ModelError
from bodylog.kinematics.rotations import make_transform, rotation_from_vector
from bodylog.settings import Settings
from bodylog.types import Series
from tests.body.boards import features, image
from tests.body.kinematic_arms import OFFSETS, given
from tests.kinematics import robots

STEP = np.array([0.03, 0.0, -0.02, 0.0, 0.06, 0.04])
"""m, rad: by how much the board's unknowns differ in the second log."""
IMAGES = 12


def board_centre_shift() -> float:
    """By how much STEP moves the board's own centre, m."""
    rig = robots.board()
    anchor = rig.carriers[0].anchor
    centre = anchor[:3, :3] @ rig.sights[0].points.mean(axis=0) + anchor[:3, 3]
    return float(np.linalg.norm(rotation_from_vector(STEP[3:]) @ centre + STEP[:3] - centre))


def pair(seed, board=None, camera=None):
    """Two logs of the same arm; in the second one the board's unknowns or the camera's pose are others."""
    first = features(robots.angles(IMAGES, seed=seed), seed)
    angles = robots.angles(IMAGES, seed=seed + 10)
    second = features(angles, seed + 5, board=board)
    if camera is not None:
        rig = robots.board()
        moved = replace(rig, cameras=(replace(rig.cameras[0], anchor=camera @ rig.cameras[0].anchor),))
        noise = np.random.default_rng(seed).normal(0.0, 0.1, (IMAGES, 12, 2))
        places = image(angles, rig=moved) + noise
        ns = (np.arange(IMAGES) * 1e9).astype(np.int64)
        tracks = {
            name: Series(ns * 1e-9, places[:, k], ("u", "v"), "px", ns) for k, name in enumerate(second.tracks)
        }
        second = replace(second, tracks=tracks)
    return [first, second]


def fitted(logs):
    plain = body.learn_body(logs, Settings(), {}, None, "all")
    return learn_kinematics(logs, Settings(), plain, given())


def moves(found):
    return [one for one in found.findings if " moved between " in one.text]


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.soak), pytest.param(3, marks=pytest.mark.soak)])
def test_board_that_moved_has_a_placement_in_each_log_and_the_zeros_stay_as_sure(seed, tmp_path):
    still, found = fitted(pair(seed)), fitted(pair(seed, board=STEP))
    assert not moves(still)
    (text,) = (one.text for one in moves(found))
    assert text.startswith("board moved between log 1 and log 2, by ")
    shift, std = (float(number) for number in text.partition(" by ")[2].partition(" mm")[0].split(" ± "))
    assert abs(shift - 1e3 * board_centre_shift()) < max(4.0 * std, 0.4)
    zeros = [{one.joint: one for one in calibration_of_body(each.model).zeros} for each in (still, found)]
    for name in ("lift", "elbow"):
        assert zeros[1][name].std < 1.3 * zeros[0][name].std
        assert abs(zeros[1][name].value - OFFSETS[name]) < 3.0 * zeros[1][name].std
    files.save(found.model, tmp_path / "body.npz")
    placed = calibration_of_body(files.load_body(tmp_path / "body.npz"))
    (before,) = placed.earlier
    assert before.name == "board in log 1" and before.identifiable
    apart = np.linalg.norm(before.pose[:3, 3] - placed.markers[0].pose[:3, 3])
    assert apart > 0.02  # the board's origin, in its link


@pytest.mark.soak
def test_camera_that_was_pushed_is_named_and_keeps_its_lens():
    push = make_transform(rotation_from_vector(np.array([0.0, 0.05, 0.02])), np.array([0.03, 0.0, 0.02]))
    found = fitted(pair(1, camera=push))
    (text,) = (one.text for one in moves(found))
    assert text.startswith("camera moved between log 1 and log 2, by ")
    placed = calibration_of_body(found.model)
    assert [one.name for one in placed.earlier] == ["camera in log 1"]
    assert (np.abs(placed.lenses[0].focal - 600.0) < 4.0 * placed.lenses[0].focal_std).all()


SPOILT = {
    "earlier": lambda _: [{"name": "board"}],
    "cameras": lambda kept: [{**kept[0], "pose": [[1.0]]}],
    "lenses": lambda kept: [{**kept[0], "focal": [600.0]}],
    "zeros": lambda kept: [{**kept[0], "std": "wide"}],
}


def test_body_file_with_a_spoilt_calibration_is_refused_by_name(tmp_path):
    found = fitted([features(robots.angles(IMAGES), 1)]).model
    kept = found.provenance["calibration"]
    for part, spoil in SPOILT.items():
        spoilt = {**found.provenance, "calibration": {**kept, part: spoil(kept[part])}}
        with pytest.raises(ModelError, match=rf"provenance\.calibration\.{part}"):
            files.save(replace(found, provenance=spoilt), tmp_path / "body.npz")
    without = {name: value for name, value in found.provenance.items() if name != "calibration"}
    with pytest.raises(ModelError, match="earlier version, which kept no calibration"):
        calibration_of_body(replace(found, provenance=without))

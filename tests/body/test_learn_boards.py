"""Boards: all points share a camera, a pose and the joints' zeros; each point is a sense."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog import body
from bodylog.body import log_scores
from bodylog.body import storage as files
from bodylog.body.kinematic import change
from bodylog.body.kinematic.learn import learn_kinematics
from bodylog.body.kinematic.model import KinematicGP
from bodylog.body.kinematic.offsets import learned_zeros as offsets
from bodylog.kinematics.rotations import rotation_from_vector
from bodylog.settings import Settings
from bodylog.types import Finding
from tests.body.boards import RARE, features, image
from tests.body.kinematic_arms import DEGREE, OFFSETS, given
from tests.kinematics import robots
from tests.kinematics.robots import ARM, JOINTS

STEP = 1e-6


@pytest.fixture(scope="module")
def explored():
    return features(robots.angles(40))


@pytest.fixture(scope="module")
def learned(explored):
    return learn_kinematics([explored], Settings(), body.learn_body([explored], Settings(), {}, None, True), given())


def test_corners_are_predicted_by_one_calibration(learned):
    q = robots.angles(200, seed=8)
    names = list(learned.model.senses)
    found = list(learned.model.senses.values())
    assert len(names) == 4 and f"board.{RARE}" not in names  # one in each part of the board
    assert all(isinstance(one, KinematicGP) for one in found)
    assert all(np.array_equal(one.theta, found[0].theta) for one in found)
    error = np.stack([one.predict(q)[0] for one in found], axis=1) - image(q)[:, [int(n[6:]) for n in names]]
    assert np.sqrt(np.square(error).mean()) < 0.7 and np.median(np.hypot(*np.moveaxis(error, -1, 0))) < 0.6
    ratio = np.square(error) / np.stack([one.predict(q)[2] + one.noise for one in found], axis=1)
    assert ratio.mean() < 1.6 and (ratio < 4).mean() > 0.9


def test_zeros_are_found_and_turning_one_joint_moves_its_own_alone(learned, explored):
    by_joint = {one.joint: one for one in offsets(learned.model)}
    assert not by_joint["pan"].identifiable and not by_joint["wrist"].identifiable
    for name in ("lift", "elbow"):
        assert by_joint[name].identifiable and by_joint[name].std < 0.6 * DEGREE
        assert abs(by_joint[name].value - OFFSETS[name]) < 3 * by_joint[name].std
    turned = features(robots.angles(40), turned=np.array([0.0, 0.0, DEGREE, 0.0]))
    plain = body.learn_body([turned], Settings(), {}, None, True)
    after = {one.joint: one for one in offsets(learn_kinematics([turned], Settings(), plain, given()).model)}
    assert after["elbow"].value - by_joint["elbow"].value == pytest.approx(-DEGREE, abs=0.15 * DEGREE)
    assert after["lift"].value == pytest.approx(by_joint["lift"].value, abs=0.15 * DEGREE)


def test_scores_and_findings_name_the_board_and_not_each_corner(learned):
    names = {score.name for score in learned.scores}
    assert "rmse/held_out/board" in names and "rmse/kinematics/board" in names
    assert not any(name.startswith("rmse/held_out/board.") for name in names)
    assert not any(one.text.startswith("board.") for one in learned.findings)
    assert any(one.text.startswith("board: camera on base, marker on ") for one in learned.findings)


def test_observability_is_that_of_kinematics_and_not_of_a_process_without_it(explored):
    alone = body.learn_body([explored], Settings(), {}, None, True)
    board_findings = (Finding("warning", "lift: moved 0.9 rad, board only 3 px: vision hardly observes it"),)
    found = learn_kinematics([explored], Settings(), replace(alone, faint=board_findings), given())
    assert found.faint == ()
    effects = {s.name: s.value for s in found.scores if s.name.startswith("influence/")}
    assert set(effects) == {f"influence/board/{name}" for name in JOINTS}
    assert min(effects.values()) > 10.0


def test_displacement_is_that_of_the_boards_own_centre_and_not_of_its_links_origin(learned):
    rig = robots.board()
    carrier, points = rig.carriers[0], rig.sights[0].points
    centre = carrier.anchor[:3, :3] @ points.mean(axis=0) + carrier.anchor[:3, 3]
    turn, shift = np.array([0.0, 0.06, 0.04]), np.array([0.002, 0.0, -0.0022])
    # p -> exp(w) p + v turns about the link's origin, 13 cm away
    board = np.concatenate([centre + shift - rotation_from_vector(turn) @ centre, turn])
    assert np.linalg.norm(board[:3]) > 1.4 * np.linalg.norm(shift)
    (one,) = change.find_changes(features(robots.angles(60, seed=11), seed=5, board=board), learned.model).changes
    assert (one.kind, one.name) == ("marker", "board")
    assert abs(one.shift[0] - np.linalg.norm(shift)) < 3 * one.shift[1] < 0.0015
    assert abs(one.turn[0] - np.linalg.norm(turn)) < 3 * one.turn[1] < 0.03


def test_save_keeps_each_board_corner_exactly(learned, tmp_path):
    files.save(learned.model, tmp_path / "body.npz")
    found, x = files.load_body(tmp_path / "body.npz"), robots.angles(5, seed=4)
    for name, sense in learned.model.senses.items():
        for one, other in zip(found.senses[name].predict(x), sense.predict(x), strict=True):
            assert np.array_equal(one, other)
    for one, other in zip(offsets(found), offsets(learned.model), strict=True):
        assert one == other


def test_slopes_are_finite_differences_and_one_point_equals_many(learned):
    gp, x = next(iter(learned.model.senses.values())), robots.angles(4, seed=3)
    value, slope, spread = gp.predict(x)
    numeric = [(gp.predict(x + s)[0] - gp.predict(x - s)[0]) / (2 * STEP) for s in STEP * np.eye(4)]
    np.testing.assert_allclose(slope, np.stack(numeric, axis=-1), atol=1e-3)
    for k in range(4):
        for one, many in zip(gp.predict_one(x[k]), (value[k], slope[k], spread[k]), strict=True):
            np.testing.assert_allclose(one, many, rtol=1e-8, atol=1e-8)


def test_score_of_a_board_covers_all_corners(learned):
    other = features(robots.angles(30, seed=21), seed=5)
    scores = {score.name: score.value for score in log_scores.score_body_on_tests(learned.model, [other])[0]}
    each = [k for k in range(12) if f"sightings/test/board.{k}" in scores]
    assert scores["sightings/test/board"] == sum(scores[f"sightings/test/board.{k}"] for k in each)
    assert scores["rmse/test/board"] < 1.0 and 80.0 < scores["coverage_2sigma/test/board"] <= 100.0


SCALED = ARM.replace("0 -0.05 0.4", "0 -0.0525 0.42").replace("0 0 0.35", "0 0 0.3675").replace("0 0.1 0", "0 0.105 0")
"""The arm with its links between joints longer by 5 %."""


def test_learn_finds_overlong_links_from_the_board_size(explored):
    plain = body.learn_body([explored], Settings(), {}, None, True)
    found = learn_kinematics([explored], Settings(), plain, given(SCALED))
    assert found.model is plain.model
    assert "all the robot's links are " in found.findings[-1].text and " shorter " in found.findings[-1].text

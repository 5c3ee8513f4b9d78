"""A Franka's camera in hand: learned from half of a session, from joints or from poses of its flange."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from bodylog import pipeline, views
from bodylog.config import load_settings
from bodylog.errors import EvidenceError
from bodylog.kinematics import urdf
from bodylog.kinematics.chain import chain_between
from bodylog.kinematics.rotations import invert_transform, make_transform, rotation_from_vector
from bodylog.robot import calibration
from bodylog.settings import MarkerSettings
from tests.kinematics.bullet import ends_of

DATA = Path(__file__).parents[3] / "shared" / "real" / "franka"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="the Franka's images (../shared/real/franka) are not at hand")


def rows_of(name, rows, folder):
    """Some rows of a table, with their images beside it."""
    head, *lines = (DATA / "A" / name).read_text().splitlines()
    chosen = [str(line) for line in np.array(lines)[rows]]
    for picture in {line.partition(",")[0] for line in chosen}:
        shutil.copy(DATA / "A" / picture, folder / picture)
    path = folder / f"{len(chosen)}_{name}"
    path.write_text("\n".join([head, *chosen]) + "\n")
    return path


def learned(log, folder, robot=None, **known):
    """The calibration that fit writes, and what it printed."""
    settings = load_settings(DATA / "robot.toml")
    settings = replace(settings, kinematics=replace(settings.kinematics, urdf=robot), **known)
    result = pipeline.fit([log], folder / "body.npz", settings)
    return calibration.load_calibration(folder / "body.npz"), result


def flange_poses(rows):
    table = np.genfromtxt(DATA / "A" / "both.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    q = np.column_stack([table[f"panda_joint{k}"] for k in range(1, 8)])[rows]
    matrix = [[table[f"O_T_EE_{r}{c}"] for c in range(4)] for r in range(4)]
    return q, np.moveaxis(np.array(matrix), -1, 0)[rows]


def frames_by_pybullet(written, q, folder):
    """Poses of the links of a written URDF at readings q (N,7), by another library; without meshes, which are not here."""
    pybullet = pytest.importorskip("pybullet")
    text = re.sub(r"<(visual|collision)\b.*?</\1>|<limit[^>]*/>", "", written.read_text(), flags=re.DOTALL)
    readings = [{f"panda_joint{k + 1}": value for k, value in enumerate(row)} for row in q.tolist()]
    return [ends_of(pybullet, text, one, folder) for one in readings]


@pytest.fixture(scope="module")
def robot():
    return str(DATA / "panda.urdf")


def test_board_stays_where_it_is_over_images_held_out(robot, tmp_path):
    train, test = np.arange(0, 12, 2), np.arange(1, 12, 2)
    found, _ = learned(rows_of("poses.csv", train, tmp_path), tmp_path, robot)
    q, _ = flange_poses(test)
    _, features = pipeline.observe(rows_of("poses.csv", test, tmp_path), load_settings(DATA / "robot.toml"))
    names, points = features.boards["board"]
    chain = chain_between(urdf.load_urdf(Path(robot)), "panda_link0", found.cameras[0].link)
    zeros = {one.joint: one.value for one in found.zeros if one.identifiable}
    arm = chain.at(q[:, : len(chain.joints)] + np.array([zeros.get(name, 0.0) for name in chain.joints]))
    lens = found.lenses[0]
    matrix = np.array([[lens.focal[0], 0, lens.centre[0]], [0, lens.focal[1], lens.centre[1]], [0, 0, 1.0]])
    distortion = np.array([*lens.distortion, 0.0, 0.0, 0.0])
    places = []
    for row in range(len(test)):
        corners = np.array([features.tracks[name].values[row] for name in names if name in features.tracks])
        there = np.array([point for name, point in zip(names, points, strict=True) if name in features.tracks])
        seen = np.isfinite(corners).all(axis=1)
        _, turn, place = cv2.solvePnP(there[seen], corners[seen], matrix, distortion)
        board = make_transform(cv2.Rodrigues(turn)[0], place[:, 0])
        places.append((make_transform(arm.rotation[row], arm.place[row]) @ found.cameras[0].pose @ board)[:3, 3])
    scatter = np.linalg.norm(np.array(places) - np.mean(places, axis=0), axis=1)
    assert 1e3 * np.sqrt(np.mean(scatter**2)) < 2.5
    calibration.write_calibration(found, tmp_path / "written.urdf", Path(robot), {})
    elsewhere = frames_by_pybullet(tmp_path / "written.urdf", q, tmp_path)
    for row in range(len(test)):
        expected = make_transform(arm.rotation[row], arm.place[row]) @ found.cameras[0].pose
        np.testing.assert_allclose(elsewhere[row]["camera_optical_frame"], expected, atol=1e-6)


def test_joints_and_poses_agree_on_the_camera(robot, tmp_path):
    every = np.arange(12)
    by_joints, result = learned(rows_of("both.csv", every, tmp_path), tmp_path, robot)
    assert {one.joint for one in by_joints.zeros} <= {f"panda_joint{k}" for k in range(1, 8)}
    by_poses, _ = learned(rows_of("ee_poses.csv", every, tmp_path), tmp_path)
    warnings = [one.text for one in by_poses.findings if one.severity == "warning"]
    assert not by_poses.zeros and warnings == ["poses of O_T_EE alone do not tell the joints' zeros; learn from joints with --urdf"]
    assert by_poses.cameras[0].link == "O_T_EE" and by_poses.markers[0].link == "base"
    q, flange = flange_poses(every)
    chain = chain_between(urdf.load_urdf(Path(robot)), "panda_link0", by_joints.cameras[0].link)
    arm = chain.at(q[:, : len(chain.joints)])
    on_flange = invert_transform(flange[0]) @ make_transform(arm.rotation[0], arm.place[0])
    apart = (on_flange @ by_joints.cameras[0].pose)[:3, 3] - by_poses.cameras[0].pose[:3, 3]
    std = np.hypot(np.linalg.norm(by_poses.cameras[0].place_std), np.linalg.norm(by_joints.cameras[0].place_std))
    assert np.linalg.norm(apart) < 2.0 * std
    warnings = [one for one in result.findings if one.severity != "info"]
    assert len(result.verdict) + len(warnings) <= 12 and json.dumps(calibration.calibration_as_values(by_poses))


def test_a_known_board_turned_about_the_base_is_the_zero_of_joint_1(robot, tmp_path):
    log = rows_of("poses.csv", np.arange(12), tmp_path)
    zeros = []
    for turn in (0.0, np.radians(1.0)):
        place = rotation_from_vector(np.array([0.0, 0.0, turn])) @ np.array([0.391, 0.133, -0.02])
        known = (*place.tolist(), np.pi, 0.0, 0.0055 + turn)
        marker = MarkerSettings(link="panda_link0", place=known, place_std=0.001, turn_std=0.1)
        found, _ = learned(log, tmp_path, robot, marker=marker)
        np.testing.assert_allclose(found.markers[0].pose[:3, 3], place, atol=0.003)
        zeros.append({one.joint: one for one in found.zeros}["panda_joint1"])
    assert all(one.identifiable and one.std < np.radians(0.25) for one in zeros)  # without it, it is not
    assert abs(zeros[1].value - zeros[0].value - np.radians(1.0)) < np.radians(0.03)


@pytest.mark.soak
def test_board_moved_between_two_logs_is_found_and_the_zeros_stay_as_sure(robot, tmp_path):
    settings = load_settings(DATA / "robot.toml")
    settings = replace(settings, kinematics=replace(settings.kinematics, urdf=robot))
    logs = [rows_of("poses.csv", np.arange(0, 12, 2), tmp_path)]
    (tmp_path / "moved").mkdir()
    moved = rows_of("poses.csv", np.arange(1, 12, 2), tmp_path / "moved")
    head, *lines = moved.read_text().splitlines()
    cells = [line.split(",") for line in lines]
    # joint 1 turns the base before a resting board: the board moves about the base, and nothing else does
    turned = [",".join([one[0], str(float(one[1]) + 0.1), *one[2:]]) for one in cells]
    moved.write_text("\n".join([head, *turned]) + "\n")
    result = pipeline.fit([*logs, moved], tmp_path / "two.npz", settings)
    (text,) = (one.text for one in result.findings if " moved between " in one.text)
    turn, std = (float(number) for number in text.partition(" mm and ")[2].partition("°")[0].split(" ± "))
    assert abs(turn - np.degrees(0.1)) < 4.0 * std < 0.5
    two = {one.joint: one for one in calibration.load_calibration(tmp_path / "two.npz").zeros}
    one_log, again = learned(rows_of("poses.csv", np.arange(12), tmp_path), tmp_path, robot)
    assert not any(" moved between " in one.text for one in again.findings)
    one = {zero.joint: zero for zero in one_log.zeros}
    for name in ("panda_joint2", "panda_joint5"):
        assert two[name].std < 1.3 * one[name].std
        assert abs(two[name].value - one[name].value) < 2.0 * one[name].std


def test_features_prints_the_board_in_one_line_and_fit_corrects_swapped_counts(robot, tmp_path):
    log = rows_of("poses.csv", np.arange(0, 12, 3), tmp_path)
    found = views.find_feature_candidates(log, None, load_settings(None), None)
    boards = [one for one in found.candidates if one["kind"] == "board"]
    assert [one["name"] for one in boards] == ["board 5x7 (6x6_250)"]
    line = boards[0]["line"]
    assert line.startswith('board = {charuco = "5x7", ') and "measure square and marker" in line
    assert not any(one["name"].startswith("tag ") for one in found.candidates)
    swapped = tmp_path / "swapped.toml"
    swapped.write_text((DATA / "robot.toml").read_text().replace("5x7", "7x5"))
    with pytest.raises(EvidenceError, match='numbered as on a board of 5 columns: type: charuco = "5x7"'):
        pipeline.fit([log], tmp_path / "none.npz", load_settings(swapped))

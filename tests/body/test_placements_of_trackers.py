"""A tracker's frame, the points that it measures and joints' zeros, from points in space, with honest error bars."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bodylog import body
from bodylog.body import storage
from bodylog.body.kinematic.learn import Robotics, learn_kinematics
from bodylog.body.kinematic.placements import calibration_of_body
from bodylog.kinematics import urdf
from bodylog.kinematics.links import CameraHint
from bodylog.kinematics.rotations import vector_from_rotation
from bodylog.robot import calibration
from bodylog.settings import Settings
from bodylog.types import Features, Series
from tests.body.kinematic_arms import given
from tests.body.tracked_arms import CHAIN, draw_tracked_arm, measure_points, points_series
from tests.kinematics import robots
from tests.kinematics.motoman import LEFT_ARM, left_arm_urdf


def learn(features, robot=None):
    plain = body.learn_body([features], Settings(), {}, None, True)
    return learn_kinematics([features], Settings(), plain, robot or given())


def errors(arm, found):
    """Errors over σ of zeros, of the tracker's place and turn, and of the tools' places."""
    tracker = found.trackers[0]
    zeros = zip(found.zeros, arm.zeros, strict=True)
    return (
        np.array([(one.value - zero) / one.std for one, zero in zeros if one.identifiable]),
        (tracker.pose - arm.frame)[:3, 3] / tracker.place_std,
        vector_from_rotation(tracker.pose[:3, :3] @ arm.frame[:3, :3].T) / tracker.turn_std,
        np.concatenate([(one.pose[:3, 3] - tool) / one.place_std for one, tool in zip(found.markers, arm.tools, strict=True)]),
    )


@pytest.fixture(scope="module")
def arm():
    return draw_tracked_arm(1, poses=40)


@pytest.fixture(scope="module")
def learned(arm):
    return learn(arm.features)


def test_frame_tools_and_zeros_are_within_their_error_bars(arm, learned):
    found = calibration_of_body(learned.model)
    assert not found.cameras and [one.name for one in found.trackers] == ["tracker"]
    assert found.trackers[0].link == "base" and {one.link for one in found.markers} == {"hand"}
    assert {one.joint for one in found.zeros if not one.identifiable} == {"pan", "wrist"}
    for off in errors(arm, found):
        assert (np.abs(off) < 4.0).all()
    assert max(one.std for one in found.zeros if one.identifiable) < np.radians(0.1)
    assert found.trackers[0].place_std.max() < 0.01 and max(one.place_std.max() for one in found.markers) < 0.005


@pytest.mark.parametrize(("seed", "joint"), [(1, "pan"), (2, "pan"), (3, "pan"), (1, "lift"), (2, "lift"), (3, "elbow")])
def test_a_joint_that_stood_still_has_no_zero_or_an_honest_one(seed, joint):
    """The tracker's frame takes up the first joint's zero; that of another shows through the joints around it."""
    one = draw_tracked_arm(seed, poses=40, still=robots.JOINTS.index(joint))
    found = calibration_of_body(learn(one.features).model)
    by_joint = {zero.joint: zero for zero in found.zeros}
    if joint == "pan":
        assert not by_joint["pan"].identifiable and by_joint["pan"].std > 0.9 * by_joint["pan"].beforehand
        assert by_joint["pan"].confused[0].startswith("tracker's turn")
        lines = calibration.zero_lines(found.zeros)
        assert any(line.startswith("pan") and "not identifiable: tracker's turn" in line for line in lines)
        assert calibration.calibration_as_values(found)["zeros"]["pan"]["value"] is None
    for name, true in zip(robots.JOINTS, one.zeros, strict=True):
        zero = by_joint[name]
        assert not zero.identifiable or abs(zero.value - true) < 3.0 * zero.std
    assert sum(zero.identifiable for zero in found.zeros) == (1 if joint == "pan" else 2)


@pytest.mark.soak
def test_error_bars_are_those_of_the_scatter_over_drawn_arms():
    seeds = range(100, 140)
    arms = [draw_tracked_arm(seed) for seed in seeds]
    parts = zip(*(errors(one, calibration_of_body(learn(one.features).model)) for one in arms), strict=True)
    for part in parts:
        assert 0.5 < np.square(np.concatenate(part)).mean() < 1.6


def test_one_degree_moves_one_zero(arm, learned):
    series = arm.features.joints
    turned = replace(series, values=series.values + np.radians([0.0, 1.0, 0.0, 0.0]))
    after = calibration_of_body(learn(replace(arm.features, joints=turned)).model)
    before = calibration_of_body(learned.model)
    moved = {one.joint: np.degrees(one.value - other.value) for one, other in zip(after.zeros, before.zeros, strict=True)}
    assert moved["lift"] == pytest.approx(-1.0, abs=0.05) and moved["elbow"] == pytest.approx(0.0, abs=0.05)


def test_points_and_images_in_one_fit_say_more_than_either(arm, learned):
    """A camera and a tracker at the same poses, each with its own noise."""
    q = arm.features.joints.values
    true = q + arm.zeros
    draw = np.random.default_rng(5)
    rig = robots.rig(known=False)
    at_tool = replace(rig, sights=(replace(rig.sights[0], chain=CHAIN),))
    theta = robots.truth(at_tool, {})
    image = at_tool.see(at_tool.sights[0], theta, true).image[:, 0]
    seen = image + draw.normal(0.0, 0.5, image.shape)
    dot = replace(arm.features.tracks["tracker/ball0"], values=seen, names=("u", "v"), unit="px")
    alone = replace(arm.features, tracks={"dot": dot}, picture_size=(640, 480))
    both = replace(arm.features, tracks={**arm.features.tracks, "dot": dot}, picture_size=(640, 480))
    robot = replace(given(), hints={"": CameraHint(size=(640, 480)), "tracker": CameraHint()})
    found = learn(both, robot)
    noise = {name: np.sqrt(np.mean(sense.noise)) for name, sense in found.model.senses.items()}
    assert noise["dot"] == pytest.approx(0.5, rel=0.5) and noise["tracker/ball0"] == pytest.approx(0.1, rel=0.5)
    seen = calibration_of_body(found.model)
    assert [one.name for one in seen.cameras] == ["camera"] and [one.name for one in seen.trackers] == ["tracker"]
    by_image, by_points = (calibration_of_body(one.model) for one in (learn(alone, robot), learned))
    lens = zip(seen.lenses, by_image.lenses, strict=True)
    assert all((mixed.focal_std < 0.8 * one.focal_std).all() for mixed, one in lens)
    for mixed, one, zero in zip(seen.zeros, by_points.zeros, arm.zeros, strict=True):
        if one.identifiable:
            assert mixed.std < 1.3 * one.std and abs(mixed.value - zero) < 4.0 * mixed.std


def test_body_of_points_is_stored_and_printed(learned, tmp_path):
    path = tmp_path / "body.npz"
    storage.save(learned.model, path)
    again = storage.load_body(path)
    x = robots.angles(3)
    for name, sense in learned.model.senses.items():
        for one, other in zip(sense.predict(x), again.senses[name].predict(x), strict=True):
            np.testing.assert_array_equal(one, other)
    found = calibration.load_calibration(path)
    lines = list(calibration.calibration_lines(found))
    assert any(line.startswith("tracker in base: ") and line.endswith(" mm") for line in lines)
    assert any("--frame-id base --child-frame-id tracker" in line for line in lines)
    values = calibration.calibration_as_values(found)
    assert values["cameras"] == {} and set(values["trackers"]["tracker"]) == {
        "link", "xyz_m", "xyz_std_m", "quaternion_xyzw", "rotation_std_rad",
    }  # fmt: skip
    text = calibration._corrected_urdf(found, _written_urdf(tmp_path))
    assert '<link name="tracker"/>' in text


def _written_urdf(folder):
    path = folder / "arm.urdf"
    path.write_text(robots.ARM)
    return path


def test_tracker_of_a_known_frame_keeps_it(arm):
    """Points in the frame of a link: what is known of it narrows the first joint's zero, too."""
    q = arm.features.joints.values
    true = q + np.array([0.03, *arm.zeros[1:]])
    seen = measure_points(true, arm.tools[0], np.eye(4))
    features = replace(arm.features, tracks={"base/ball": points_series(arm.features.joints.t, seen)})
    hint = CameraHint("base", np.eye(4), pose_std=np.full(6, 1e-4))
    found = calibration_of_body(learn(features, replace(given(), hints={"base": hint})).model)
    pan = next(one for one in found.zeros if one.joint == "pan")
    assert pan.identifiable and pan.value == pytest.approx(0.03, abs=4.0 * pan.std) and pan.std < 0.005
    assert np.linalg.norm(found.trackers[0].pose[:3, 3]) < 1e-3


def test_points_that_no_joint_moves_are_refused(arm):
    still = points_series(arm.features.joints.t, np.random.default_rng(0).normal(0.0, 1e-4, (60, 3)))
    found = learn(replace(arm.features, tracks={**arm.features.tracks, "tracker/rock": still}))
    assert "tracker/rock" not in found.model.senses
    assert any(one.text.startswith("tracker/rock: left out") and " mm " in one.text for one in found.findings)


def test_points_that_a_controller_computed_are_doubted(arm, learned):
    """Forward kinematics of the readings themselves agree with them as no tracker does."""
    q = arm.features.joints.values
    computed = points_series(arm.features.joints.t, measure_points(q, arm.tools[0], np.eye(4)))
    found = learn(replace(arm.features, tracks={"tracker/tcp": computed}))
    assert any("more exactly than trackers measure" in one.text for one in found.findings)
    assert not any("more exactly" in one.text for one in learned.findings)


def test_kinematic_scores_are_in_mm(learned):
    units = {score.unit for score in learned.scores if score.name.startswith(("rmse/", "std/noise/tracker"))}
    assert units == {"mm"}


MOTOMAN = Path(__file__).parents[3] / "shared" / "real" / "motoman" / "leica_left_hand_6x6x6.csv"


@pytest.fixture(scope="module")
def motoman(tmp_path_factory):
    """The robot of a real arm, a function that learns from its tracker alone, and the table's columns."""
    if not MOTOMAN.is_file():
        pytest.skip("the measured poses (../shared/real/motoman) are not at hand")
    table = np.genfromtxt(MOTOMAN, delimiter=",", names=True)
    robot = Robotics(urdf.parse_urdf(left_arm_urdf(), "motoman.urdf"), {}, np.radians(5.0))

    def learn_poses(chosen, turned=None):
        names = tuple(LEFT_ARM)
        t = np.arange(len(chosen), dtype=float)
        q = np.column_stack([table[name][chosen] for name in names])
        q += np.radians([float(name == turned) for name in names])
        points = np.column_stack([table[f"leica_{axis}"][chosen] for axis in "xyz"])
        joints = Series(t, q, names, "rad", (t * 1e9).astype(np.int64))
        return learn(Features(joints, {"tracker/leica": points_series(t, points)}, None, (), (), {}, poses=True), robot).model

    return learn_poses, table


def test_real_arm_is_predicted_to_a_quarter_of_a_millimetre_by_its_calibration(motoman):
    """Every third of 208 poses withheld; by kinematics alone, and with the process beside them."""
    learn_poses, table = motoman
    rows = np.arange(len(table))
    withheld = rows[rows % 3 == 2]
    found = learn_poses(rows[rows % 3 != 2])
    sense = found.senses["tracker/leica"]
    seen = 1e3 * np.column_stack([table[f"leica_{axis}"][withheld] for axis in "xyz"])
    q = np.column_stack([table[name][withheld] for name in found.joints])
    off = [np.linalg.norm(seen - predicted, axis=1) for predicted in (sense.kinematics(q), sense.means(q)[0])]
    alone, both = (np.sqrt(np.nanmean(np.square(one))) for one in off)
    assert alone < 0.25 and both < 0.12
    # the first joint of the chain stood still: a tracker's frame turns as it does
    zeros = {one.joint: one for one in calibration_of_body(found).zeros}
    assert {name for name, one in zeros.items() if not one.identifiable} == {"external_E", "left_S", "left_T"}
    assert zeros["external_E"].confused[0].startswith("tracker's turn")


@pytest.mark.soak
def test_one_degree_moves_one_zero_of_a_real_arm(motoman):
    learn_poses, table = motoman
    rows = np.arange(len(table))
    before, after = (calibration_of_body(learn_poses(rows, turned)) for turned in (None, "left_L"))
    moved = {one.joint: np.degrees(one.value - other.value) for one, other in zip(after.zeros, before.zeros, strict=True)}
    assert moved.pop("left_L") == pytest.approx(-1.0, abs=0.05)
    known = {one.joint for one in before.zeros if one.identifiable}
    assert max(abs(size) for joint, size in moved.items() if joint in known) < 0.05

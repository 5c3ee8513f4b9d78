import inspect
from types import SimpleNamespace

import click
import cv2
import numpy as np
import pytest
from bodylog_cli.commands import bodylog
from bodylog_cli.record import record as command

from bodylog.errors import UsageError
from bodylog.sim import record_scenario
from bodylog.sim.options import Options
from bodylog.sim.scene import FOREIGN_TAG, TAG, Cylinder, before_the_wrist, studs
from tests.seeds import seeds

from . import reading
from .reading import tags

pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")


def transform(message):
    """Rotation (3,3) and place (3,) of a Transform or Pose."""
    turn = message.rotation if hasattr(message, "rotation") else message.orientation
    place = message.translation if hasattr(message, "translation") else message.position
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross, np.array([place.x, place.y, place.z])


@pytest.mark.parametrize("arm, camera, share", [("ur5", "head", 0.95), ("seven", "head", 0.95), ("ur5", "wrist", 0.6)])
@pytest.mark.parametrize("seed", seeds(1, 3))
def test_opencv_finds_the_tag_where_truth_says_it_is(tmp_path, arm, camera, share, seed):
    options = {"arm": arm, "camera": camera, "feature": "tag", "clutter": True, "full": True}
    record_scenario("babble", tmp_path / "a.mcap", seed=seed, duration=1.5, **options)
    topics = reading.read(tmp_path / "a.mcap")
    truth = reading.pixels(topics, "/truth/effector_pixel")
    found = {t: tags(picture) for t, picture in reading.pictures(topics)}
    assert len(truth) >= share * len(found)
    errors = np.array([found[t][TAG] - truth[t] for t in truth if TAG in found[t]])
    assert len(errors) >= 0.95 * len(truth)
    assert np.median(np.linalg.norm(errors, axis=1)) < 0.4


def test_clutter_has_the_features_colour_is_bigger_and_nearer_and_never_moves(tmp_path):
    logs = []
    for clutter in (False, True):
        record_scenario("babble", tmp_path / "a.mcap", seed=1, duration=1.0, clutter=clutter)
        logs.append(reading.read(tmp_path / "a.mcap"))
    truth = reading.pixels(logs[0], "/truth/effector_pixel")
    assert len(truth) == 20 and str(truth) == str(reading.pixels(logs[1], "/truth/effector_pixel"))
    plain, full = (dict(reading.pictures(log)) for log in logs)
    static = None
    for t, uv in list(truth.items())[::4]:
        u, v = np.rint(uv).astype(int)
        assert green(plain[t])[v, u] and green(full[t])[v, u]
        areas = cv2.connectedComponentsWithStats(green(full[t]).astype(np.uint8))[2][1:, cv2.CC_STAT_AREA]
        mine = cv2.connectedComponentsWithStats(green(plain[t]).astype(np.uint8))[2][1:, cv2.CC_STAT_AREA].max()
        assert (areas > 2 * mine).sum() >= 2 and (areas > mine / 2).sum() >= 4
        seen = tags(full[t])
        assert TAG not in seen
        if FOREIGN_TAG in seen:
            static = seen[FOREIGN_TAG] if static is None else static
            assert np.linalg.norm(seen[FOREIGN_TAG] - static) < 0.5
    assert static is not None
    saturated = [cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)[..., 1] > 150 for picture in (plain[t], full[t])]
    assert saturated[1].mean() > 0.15 > 20 * saturated[0].mean()


def green(picture):
    return picture[..., 1].astype(int) - np.delete(picture, 1, axis=2).max(axis=2) > 60


def test_parts_have_separate_topics_rates_and_clocks(tmp_path):
    options = {"split_joints": True, "turning": True, "size": (96, 64), "noise": 0.001}
    record_scenario("reach", tmp_path / "a.mcap", seed=3, duration=8.0, **options)
    topics = reading.read(tmp_path / "a.mcap")
    assert "/joint_states" not in topics
    t, truth, names = reading.positions(topics, "/truth/joint_states")
    parts = {"arm": (100, 0.0), "head": (30, 0.020), "gripper": (50, -0.007)}
    for part, (rate, ahead) in parts.items():
        stamps, read, joints = reading.positions(topics, f"/{part}/joint_states")
        assert len(stamps) == 8 * rate and joints == sorted(joints)
        true = truth[:, [names.index(joint) for joint in joints]]
        shifts = np.arange(-0.05, 0.0501, 0.001)
        moved = [np.column_stack([np.interp(stamps - shift, t, column) for column in true.T]) for shift in shifts]
        assert shifts[np.argmin([np.abs(read - m)[10:-10].mean() for m in moved])] == pytest.approx(ahead, abs=0.0015)
    assert {"head_pan_joint", "gripper_joint"} < set(names) and len(names) == 8


@pytest.mark.parametrize("feature", ["tag", "ball"])
def test_wrist_camera_sees_the_scene_through_the_chain(tmp_path, feature):
    record_scenario("babble", tmp_path / "a.mcap", seed=2, duration=3.0, size=(320, 240), camera="wrist", feature=feature)
    topics = reading.read(tmp_path / "a.mcap")
    k = topics["/camera/camera_info"][0].message.k.reshape(3, 3)
    (static,) = topics["/tf_static"][0].message.transforms
    assert static.header.frame_id in topics["/robot_description"][0].message.data
    assert static.child_frame_id == topics["/camera/camera_info"][0].message.header.frame_id
    turn, place = transform(static.transform)
    truth = reading.pixels(topics, "/truth/effector_pixel")
    assert len(truth) > 40 and len({row.message.pose.position.x for row in topics["/truth/feature_pose"]}) == 1
    for tf, pose in zip(topics["/tf"], topics["/truth/feature_pose"], strict=True):
        frames = {frame.child_frame_id: transform(frame.transform) for frame in tf.message.transforms}
        assert static.child_frame_id not in frames
        link_turn, link_place = frames[static.header.frame_id]
        local = (link_turn @ turn).T @ (transform(pose.message.pose)[1] - link_place - link_turn @ place)
        radius = 0.0 if feature == "tag" else 0.025  # a sphere's outline is centred a little farther out
        local[:2] *= local[2] ** 2 / (local[2] ** 2 - radius**2)
        if pose.t in truth:
            assert np.linalg.norm((k @ local / local[2])[:2] - truth[pose.t]) < 1e-3
    assert np.ptp(list(truth.values()), axis=0).min() > 30  # what stands still moves in the image


def test_feature_size_is_that_of_its_image(tmp_path):
    widths = []
    for size in (0.03, 0.06):
        record_scenario("babble", tmp_path / "a.mcap", duration=0.1, size=(320, 240), feature_size=size)
        widths.append(np.sqrt(green(reading.pictures(reading.read(tmp_path / "a.mcap"))[0][1]).sum()))
    assert widths[1] == pytest.approx(2 * widths[0], rel=0.05)


def test_feature_off_removes_drawing_and_truth(tmp_path):
    record_scenario("reach", tmp_path / "a.mcap", duration=0.2, size=(160, 120), feature="none")
    topics = reading.read(tmp_path / "a.mcap")
    assert "/truth/effector_pixel" not in topics and "/truth/effector_pose" in topics
    assert not any(green(picture).any() for _, picture in reading.pictures(topics))


def test_scene_is_deterministic(tmp_path):
    options = {"feature": "tag", "clutter": True, "split_joints": True, "camera": "wrist", "size": (96, 64)}
    for name in ("a", "b"):
        record_scenario("babble", tmp_path / f"{name}.mcap", seed=5, duration=0.5, **options)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


@pytest.mark.parametrize(
    "wrong, words",
    [
        ({"feature": "tga"}, "feature 'tga' is not known; possible: ball, tag, none; nearest: tag; type: --feature"),
        ({"camera": "rist"}, "camera 'rist' is not known; possible: head, wrist; nearest: wrist"),
        ({"feature_size": 2.0}, "feature-size is 2.0; possible: 0.005 to 0.5"),
        ({"scene": "bare", "feature": "tag"}, "it has no feature; leave --feature"),
        ({"scene": "bare", "marker": True}, "it has no feature; leave --feature"),
        ({"feature": "none", "feature_size": 0.1}, "there is no feature .*; leave --feature-size out"),
        ({"camera": "wrist", "marker": True}, "--marker needs the head's camera .*; leave --marker out"),
        ({"camera": "wrist", "cameras": 2}, "--cameras needs the head's camera"),
        ({"camera": "wrist", "turning": True}, "--turning needs the head's camera"),
        ({"camera": "wrist", "scenario": "touch"}, "scenario touch: .*; type: --camera head"),
    ],
)
def test_scene_names_impossible_options(tmp_path, wrong, words):
    with pytest.raises(UsageError, match=words):
        record_scenario(**{"scenario": "reach", "out": tmp_path / "x.mcap", "duration": 6.0, **wrong})
    assert not list(tmp_path.iterdir())


def test_record_command_has_all_options_with_their_defaults():
    above = click.Context(bodylog, **bodylog.context_settings)  # commands keep the help option of their first context
    typed = command.make_context("record", ["reach", "-o", "a.mcap"], parent=above).params
    typed["size"] = tuple(int(side) for side in typed["size"].split("x"))
    for name, parameter in inspect.signature(Options).parameters.items():
        assert typed[name] == parameter.default, name


def test_bare_arm_has_studs_on_its_links_and_no_feature(tmp_path):
    """Each stud lies on a cylinder, dark or light and grey; the log has no truth of a feature."""
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    one = Cylinder("link", np.array([0.1, 0.0, 0.2]), turn, 0.05, 0.3)
    found = studs([one], np.random.default_rng(3))
    local = np.array([turn.T @ (ball.place - one.place) for _, ball in found])
    np.testing.assert_allclose(np.linalg.norm(local[:, :2], axis=1), 0.05, atol=1e-12)
    assert np.abs(local[:, 2]).max() < 0.15
    assert all(len(set(ball.colour)) == 1 for _, ball in found)
    record_scenario("reach", tmp_path / "bare.mcap", duration=0.2, size=(160, 120), scene="bare")
    record_scenario("reach", tmp_path / "again.mcap", duration=0.2, size=(160, 120), scene="bare")
    assert (tmp_path / "bare.mcap").read_bytes() == (tmp_path / "again.mcap").read_bytes()
    topics = reading.read(tmp_path / "bare.mcap")
    assert "/robot_description" in topics
    assert "/truth/effector_pixel" not in topics


def test_bare_camera_on_the_wrist_sees_stones_at_rest(tmp_path):
    """They lie around the place that it looks at, grey, and no wall turns with it."""
    stage = SimpleNamespace(position=np.array([0.4, 0.0, 0.5]), rotation=np.eye(3)[[0, 2, 1]])
    found = before_the_wrist(Options(scene="bare", camera="wrist"), stage, 0.5, np.random.default_rng(3))
    assert found.feature is None and found.link is None
    places = np.array([stone.place for stone in found.things])
    ahead = stage.position + 0.5 * stage.rotation[2]
    assert len(places) > 100 and np.abs(places - ahead).max() < 0.5
    assert all(len(set(stone.colour)) == 1 for stone in found.things)
    record_scenario("reach", tmp_path / "a.mcap", duration=0.2, size=(160, 120), scene="bare", camera="wrist")
    record_scenario("reach", tmp_path / "b.mcap", duration=0.2, size=(160, 120), scene="bare", camera="wrist")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    assert "/truth/effector_pixel" not in reading.read(tmp_path / "a.mcap")

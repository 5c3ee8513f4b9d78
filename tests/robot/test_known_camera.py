"""What a user knows of a camera enters with its doubt; what cannot be is named."""

import numpy as np
import pytest

from bodylog.body.kinematic.placements import Lens
from bodylog.errors import ConfigError
from bodylog.kinematics import urdf
from bodylog.kinematics.links import INFO_LENS, CameraHint, MarkerTrack, Space
from bodylog.kinematics.rotations import invert_transform, rotation_from_rpy
from bodylog.robot.calibration import camera_info_yaml
from bodylog.robot.known_camera import known_markers, load_lens, with_known
from bodylog.settings import CameraSettings, MarkerSettings
from bodylog.types import Features, Series
from tests.kinematics import robots

ROBOT = urdf.parse_urdf(robots.ARM, "arm.urdf")
HINT = CameraHint(size=(1280, 720))
LENS = Lens(*(np.array(pair) for pair in ([630.0, 633.0], [1, 1], [641.0, 362.0], [1, 1], [-0.06, 0.03], [1, 1])))


def camera(known: CameraSettings):
    """The camera of a rig, as the given hint makes it."""
    hint = with_known(HINT, known, ROBOT)
    q = robots.angles(3)
    track = MarkerTrack("", "tip", robots.seen(robots.rig(), robots.rig().prior[0], q, 0.1))
    space = Space(ROBOT, robots.JOINTS, {}, 0.1)
    return space.rig([track], {"": hint.link or "base"}, {"tip": "tool"}, {"": hint}).cameras[0]


def test_a_lens_that_calibration_wrote_is_read_back(tmp_path):
    (tmp_path / "lens.yaml").write_text(camera_info_yaml("camera", LENS, (1280, 720)))
    numbers, size = load_lens(tmp_path / "lens.yaml")
    assert size == (1280, 720)
    np.testing.assert_allclose(np.exp(numbers[0]) * np.array([1.0, np.exp(numbers[1])]), LENS.focal)
    np.testing.assert_allclose(numbers[2:], [641.0, 362.0, -0.06, 0.03])
    found = camera(CameraSettings(info=str(tmp_path / "lens.yaml")))
    np.testing.assert_allclose(found.lens, numbers)
    np.testing.assert_allclose(found.doubt[6:], INFO_LENS)


def test_a_focal_length_has_the_doubt_that_was_given():
    found = camera(CameraSettings(focal=633.9, focal_std=0.002))
    assert np.exp(found.lens[0]) == pytest.approx(633.9) and found.doubt[6] == 0.002
    assert found.lens[2] == 640.0 and found.doubt[8] == 60.0  # the centre is as unknown as without
    assert camera(CameraSettings()).doubt[6] > 0.3


def test_a_place_has_the_doubt_that_was_given():
    known = CameraSettings(link="hand", place=(0.1, 0.0, 0.05, 0.0, 0.3, 0.0), place_std=0.003, turn_std=0.5)
    found = camera(known)
    pose = invert_transform(found.anchor)
    assert found.link == "hand"
    np.testing.assert_allclose(pose[:3, 3], [0.1, 0.0, 0.05], atol=1e-12)
    np.testing.assert_allclose(pose[:3, :3], rotation_from_rpy(np.array([0.0, 0.3, 0.0])), atol=1e-12)
    np.testing.assert_allclose(found.doubt[:6], [0.003] * 3 + [np.radians(0.5)] * 3)


def test_what_cannot_be_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"\[camera\] link: found 'head', possible: base, turret"):
        with_known(HINT, CameraSettings(link="head"), ROBOT)
    with pytest.raises(ConfigError, match="in which link"):
        with_known(HINT, CameraSettings(place=(0.0,) * 6), ROBOT)
    with pytest.raises(ConfigError, match="found 3 numbers, possible: 6"):
        with_known(HINT, CameraSettings(link="hand", place=(0.0,) * 3), ROBOT)
    path = tmp_path / "lens.yaml"
    with pytest.raises(ConfigError, match=r"lens\.yaml: cannot be read as YAML"):
        load_lens(path)
    text = camera_info_yaml("camera", LENS, (1280, 720))
    for bad, words in (
        ("[1, 2]", "image_width: found 'None'"),
        (text.replace("630.0", "-630.0"), "possible: positive numbers"),
        (text.replace('"data"', '"date"'), "camera_matrix: found None, possible: data: a list of 9 numbers"),
    ):
        path.write_text(bad)
        with pytest.raises(ConfigError, match=words):
            load_lens(path)


def test_a_marker_has_the_place_and_doubt_that_were_given():
    seen = Series(np.zeros(1), np.ones((1, 2)), ("u", "v"), "px", np.zeros(1, np.int64))
    one = [Features(None, {"tip": seen}, None, (), (), {})]
    two = [Features(None, {"side/tip": seen, "ball": seen}, None, (), (), {})]
    known = MarkerSettings(link="tool", place=(0.1, 0.0, 0.05, 0.0, 0.3, 0.0), place_std=0.003, turn_std=0.5)
    hints = known_markers(known, one, ROBOT)
    q = robots.angles(3)
    track = MarkerTrack("", "tip", robots.seen(robots.rig(), robots.rig().prior[0], q, 0.1))
    space = Space(ROBOT, robots.JOINTS, {}, 0.1, things=hints)
    (found,) = space.rig([track], {"": "base"}, {"tip": "tool"}, {}).carriers
    np.testing.assert_allclose(found.anchor[:3, 3], [0.1, 0.0, 0.05])
    np.testing.assert_allclose(found.doubt, [0.003] * 3)  # a point has no turn
    assert not known_markers(MarkerSettings(), two, ROBOT)
    with pytest.raises(ConfigError, match=r"\[marker\] name: found several, possible: ball, tip"):
        known_markers(known, two, ROBOT)
    with pytest.raises(ConfigError, match=r"\[marker\] link: found 'head', possible: base"):
        known_markers(MarkerSettings(link="head"), one, ROBOT)
    with pytest.raises(ConfigError, match=r"\[marker\] place: in which link"):
        known_markers(MarkerSettings(place=(0.0,) * 6), one, ROBOT)

"""Which URDF a body is learned with: the one that is asked for, else the log's own, unless none is wanted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bodylog import body
from bodylog.body.kinematic.learn import learn_kinematics
from bodylog.errors import FormatError, LogError
from bodylog.kinematics.chain import chain_between
from bodylog.kinematics.frame_robot import frame_robot
from bodylog.kinematics.rotations import rotation_from_rpy
from bodylog.logs.tables.frame_columns import FramePoses
from bodylog.recording import robot_description
from bodylog.recording.robot_description import Described
from bodylog.robot import model as robot_model
from bodylog.robot.model import _robot_of_frame
from bodylog.settings import FitSettings, KinematicsSettings, Settings
from bodylog.types import Features, Series
from tests.body.kinematic_arms import features, given
from tests.kinematics.robots import ARM, JOINTS

LOG = Path("log.mcap")


@pytest.fixture
def log_describes(monkeypatch):
    """log_describes(text): sets the log's robot description."""

    def says(text):
        monkeypatch.setattr(robot_description, "read_robot_description", lambda *_: Described(text, {}, {}))

    return says


def _robot(**chosen):
    return robot_model.find_robot([LOG], [features(5)], Settings(kinematics=KinematicsSettings(**chosen)))


def test_robot_uses_the_logs_own_description_unless_turned_off(log_describes):
    log_describes(ARM)
    known, warnings = _robot()
    assert set(JOINTS) <= set(known.robot.by_name) and not known.asked and warnings == ()
    assert _robot(urdf="log")[0].asked
    assert _robot(use=False) == (None, ())
    paper = Settings(fit=FitSettings(preset="paper"))
    assert robot_model.find_robot([LOG], [features(5)], paper) == (None, ())


def test_robot_prefers_a_named_file(log_describes, tmp_path):
    log_describes(ARM)
    (tmp_path / "other.urdf").write_text(ARM.replace('name="wrist"', 'name="hinge"'))
    known, _ = _robot(urdf=str(tmp_path / "other.urdf"))
    assert "hinge" in known.robot.by_name and known.asked


def test_robot_requires_a_description_only_if_requested(log_describes):
    log_describes(None)
    assert _robot() == (None, ())
    with pytest.raises(LogError, match="no /robot_description in it; give the URDF's file"):
        _robot(urdf="log")


def test_robot_rejects_an_unreadable_description_only_if_requested(log_describes):
    log_describes("<robot><joint/></robot>")
    known, (remark,) = _robot()
    assert known is None and remark.severity == "warning"
    assert "log.mcap: /robot_description" in remark.text and remark.text.endswith("the log's URDF is not used")
    with pytest.raises(FormatError):
        _robot(urdf="log")


def test_learn_ignores_an_unrequested_urdf_of_another_robot():
    text = ARM
    for name in JOINTS:
        text = text.replace(f'name="{name}"', f'name="left_{name}"')
    plain = body.learn_body([features()], Settings(), {})
    found = learn_kinematics([features()], Settings(), plain, replace(given(text), asked=False))
    assert found.model is plain.model and "the URDF is not used: joint 'pan' moved" in found.findings[-1].text


def test_poses_in_other_angles_are_not_mixed():
    def found(pitch):
        turns = np.stack([rotation_from_rpy(np.array([0.1 * k, pitch, 0.2 * k])) for k in range(4)])
        frame = FramePoses("hand", (), np.zeros((4, 3)), turns)
        names, values = zip(*frame.coordinates.items(), strict=True)
        there = chain_between(frame_robot("hand", names), "base", "hand").at(np.column_stack(values))
        np.testing.assert_allclose(there.rotation, turns, atol=1e-12)
        joints = Series(np.arange(4.0), np.column_stack(values), names, "rad", np.arange(4))
        return Features(joints, {}, None, (), (), {})

    level, steep = found(0.0), found(1.5)
    assert _robot_of_frame([Path("a.csv")], [level, level]) is not None
    assert not set(level.joints.names[3:]) & set(steep.joints.names[3:])  # other angles have other names
    with pytest.raises(LogError, match=r"a\.csv: the poses of hand need other angles .*\(hand\.rx2, hand\.ry\)"):
        _robot_of_frame([Path("a.csv"), Path("b.csv")], [level, steep])

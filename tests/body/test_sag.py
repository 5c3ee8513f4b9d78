"""Gravity sag: torques of a URDF's masses, compliances beside zeros, and when sag is left out."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog import body
from bodylog.body import storage
from bodylog.body.kinematic.learn import learn_kinematics
from bodylog.body.kinematic.placements import calibration_of_body
from bodylog.errors import FormatError
from bodylog.kinematics import urdf
from bodylog.kinematics.weights import collect_weights
from bodylog.robot.calibration import calibration_lines
from bodylog.settings import Settings
from tests.body.boards import features
from tests.body.kinematic_arms import OFFSETS, bend_places, given
from tests.kinematics import robots
from tests.kinematics.robots import ARM, JOINTS

MASSES = {"turret": 6.0, "upper": 5.0, "fore": 3.0, "hand": 2.0, "tool": 0.5}
COMPLIANCE = np.array([0.0, 4e-4, 8e-4, 0.0])
"""rad/(N m): up to 0.9° of sag."""


def weighty(text: str = ARM) -> str:
    """The arm with masses, their centres beside their links' frames."""
    for name, mass in MASSES.items():
        inertia = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
        inertial = f'<inertial><origin xyz="0.02 0 0.15"/><mass value="{mass}"/>{inertia}</inertial>'
        text = text.replace(f'<link name="{name}"/>', f'<link name="{name}">{inertial}</link>')
    return text


WEIGHTS = collect_weights(urdf.parse_urdf(weighty(), "arm.urdf"), JOINTS, {})


def sagging(compliance: np.ndarray, seed: int):
    """Still poses whose joints give way to gravity, by what their encoders read."""
    q = robots.angles(40, seed)
    read = q
    for _ in range(20):
        read = q - compliance * WEIGHTS.torques(read)
    seen = features(q, seed, turned=read - q)
    bend = bend_places(q, 2.0)  # that of these boards' lens
    tracks = {name: replace(one, values=one.values - bend) for name, one in seen.tracks.items()}
    return replace(seen, tracks=tracks)


def learned(explored, text: str):
    found = body.learn_body([explored], Settings(), {}, None, True)
    return learn_kinematics([explored], Settings(), found, given(text)).model


@pytest.fixture(scope="module")
def bent():
    return learned(sagging(COMPLIANCE, 1), weighty())


def test_torques_hold_the_arm_still_in_another_library(tmp_path):
    pybullet = pytest.importorskip("pybullet")
    limits = '<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
    (tmp_path / "arm.urdf").write_text(weighty().replace("</joint>", limits))
    client = pybullet.connect(pybullet.DIRECT)
    flags = pybullet.URDF_USE_INERTIA_FROM_FILE
    loaded = pybullet.loadURDF(str(tmp_path / "arm.urdf"), useFixedBase=True, flags=flags, physicsClientId=client)
    pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
    still = [0.0] * 4
    q = robots.angles(5, 3)
    held = [pybullet.calculateInverseDynamics(loaded, list(row), still, still, physicsClientId=client) for row in q]
    pybullet.disconnect(client)
    np.testing.assert_allclose(WEIGHTS.torques(q), -np.array(held), atol=1e-4)


def test_compliances_and_zeros_are_separated(bent):
    found = calibration_of_body(bent)
    known = {one.joint: one for one in found.compliances if one.identifiable}
    assert {"lift", "elbow"} <= set(known) and "pan" not in known  # nothing weighs on an upright axis
    for joint, one in known.items():
        assert abs(one.value - COMPLIANCE[JOINTS.index(joint)]) < 3.0 * one.std
    zeros = {one.joint: one for one in found.zeros if one.identifiable}
    assert {"lift", "elbow"} <= set(zeros)
    for joint, one in zeros.items():
        assert abs(one.value - OFFSETS.get(joint, 0.0)) < 3.0 * one.std
    assert any(one.text.startswith("pan: its compliance ") for one in found.findings)
    lines = list(calibration_lines(found))
    assert any(line.startswith("lift ") and "compliance" in line and "mrad/(N m)" in line for line in lines)
    assert any(line.startswith("pan ") and "compliance not identifiable" in line for line in lines)
    assert lines[-1].endswith("zeros are those without weight")


def test_without_masses_the_same_sag_is_taken_for_zeros(bent):
    blind = calibration_of_body(learned(sagging(COMPLIANCE, 1), ARM))
    assert not blind.compliances and not blind.sag

    def worst(found):
        return max(abs(one.value - OFFSETS.get(one.joint, 0.0)) for one in found.zeros if one.joint in ("lift", "elbow"))

    assert worst(calibration_of_body(bent)) < 0.5 * worst(blind)


def test_an_arm_that_does_not_sag_keeps_its_calibration():
    explored = sagging(np.zeros(4), 2)
    found = calibration_of_body(learned(explored, weighty()))
    plain = calibration_of_body(learned(explored, ARM))
    assert found.compliances == () and found.zeros == plain.zeros
    assert "so none is estimated" in found.sag


def test_body_file_keeps_compliances(bent, tmp_path):
    storage.save(bent, tmp_path / "body.npz")
    again = calibration_of_body(storage.load_body(tmp_path / "body.npz"))
    assert again.compliances == calibration_of_body(bent).compliances != ()


@pytest.mark.parametrize("mass", ["-1", "heavy", "nan", "1e9", ""])
def test_masses_that_no_link_has_are_refused(mass):
    text = weighty().replace('value="5.0"', f'value="{mass}"')
    with pytest.raises(FormatError, match=r"arm\.urdf: link 'upper': inertial: mass is .*; possible: 0 to 1e\+06 kg"):
        urdf.parse_urdf(text, "arm.urdf")

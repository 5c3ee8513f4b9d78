"""Encoder counts: counts per turn and the count at 0 rad, from [body] unit."""

from pathlib import Path

import numpy as np
import pytest

from bodylog import pipeline
from bodylog.body import storage
from bodylog.body.kinematic.offsets import learned_zeros
from bodylog.config import load_settings
from bodylog.errors import ConfigError
from bodylog.logs.joint_units import UNIT, joint_unit, parse_count_unit
from bodylog.settings import BodySettings, KinematicsSettings, Settings
from tests.body.kinematic_arms import OFFSETS, features
from tests.kinematics.robots import ARM, JOINTS, angles

READ = {"rad": lambda q: q, "deg": np.degrees, "4096 counts from 2048": lambda q: 2048 + q * 4096 / (2 * np.pi)}


def test_counts_parses_turn_and_zero():
    assert parse_count_unit("4096 counts from 2048") == (4096.0, 2048.0) and parse_count_unit("1024.5 counts") == (1024.5, 0.0)
    for text in ("rad", "deg", "counts", "0 counts", "-1 counts", "4096 counts from", "9 counts from x", "nan counts"):
        assert parse_count_unit(text) is None
    one = joint_unit({UNIT: "counts"}, "4096 counts from 2048")
    assert (one.unit, one.zero) == ("rad", 2048.0) and one.factor * 4096 == pytest.approx(2 * np.pi)
    assert joint_unit({UNIT: "deg"}, "4096 counts").read == "deg"  # a topic's declaration takes precedence
    assert joint_unit({UNIT: "counts"}, "rad").unit == "counts"


def test_settings_accept_counts_and_list_choices(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text('[body]\nunit = "4096 counts from 2048"\n')
    assert load_settings(path, {}).body.unit == "4096 counts from 2048"
    path.write_text('[body]\nunit = "4096 ticks"\n')
    with pytest.raises(ConfigError, match='possible: rad, deg, or counts of one turn: "4096 counts"'):
        load_settings(path, {})


@pytest.fixture(scope="module")
def bodies(tmp_path_factory):
    """The same poses in rad, in degrees and in counts, each learned with the URDF."""
    folder, found, seen = tmp_path_factory.mktemp("counts"), {}, features(30)
    (folder / "arm.urdf").write_text(ARM)
    track = seen.tracks["effector"].values
    for k, (unit, read) in enumerate(READ.items()):
        rows = np.column_stack([read(seen.joints.values), track])
        text = ",".join((*JOINTS, "effector_u", "effector_v")) + "\n"
        text += "\n".join(",".join(repr(float(v)) for v in row) for row in rows)
        (folder / f"{k}.csv").write_text(text + "\n")
        settings = Settings(body=BodySettings(unit=unit), kinematics=KinematicsSettings(urdf=str(folder / "arm.urdf")))
        pipeline.fit([folder / f"{k}.csv"], folder / f"{k}.npz", settings)
        found[unit] = storage.load_body(Path(folder / f"{k}.npz"))
    return found


@pytest.mark.parametrize("unit", list(READ)[1:])
def test_fit_predicts_the_same_in_any_unit(bodies, unit):
    plain, other = bodies["rad"], bodies[unit]
    x = angles(40, seed=9)
    foretold = [one.senses["effector"].predict(x)[0] for one in (plain, other)]
    np.testing.assert_allclose(*foretold, atol=0.05)
    for one, same in zip(learned_zeros(plain), learned_zeros(other), strict=True):
        assert same.joint == one.joint and abs(same.value - one.value) < 0.05 * one.std
        if same.joint in OFFSETS:
            assert same.identifiable and abs(same.value - OFFSETS[same.joint]) < 3 * same.std

"""A joint with a wrong number of counts per turn: its scale is learned, saved, printed and written."""

import json

import numpy as np
import pytest
from ruamel.yaml import YAML

from bodylog import body, pipeline
from bodylog.body import storage as files
from bodylog.body.kinematic import offsets, update
from bodylog.errors import ModelError
from bodylog.settings import BodySettings, KinematicsSettings, Settings
from tests.body.kinematic_arms import features
from tests.kinematics.robots import ARM, JOINTS, angles

SCALE, JOINT = 0.03, 1
UNIT = "4096 counts from 2048"


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """From 120 poses in counts, with 3 % fewer counts per turn of lift than of the others; the body's file."""
    folder, seen = tmp_path_factory.mktemp("scales"), features(120, bend=0.5)
    (folder / "arm.urdf").write_text(ARM)
    counts = 2048 + seen.joints.values * 4096 / (2 * np.pi) / (1 + SCALE * (np.arange(4) == JOINT))
    rows = np.column_stack([counts, seen.tracks["effector"].values])
    text = "\n".join(",".join(repr(float(v)) for v in row) for row in rows)
    (folder / "poses.csv").write_text(",".join((*JOINTS, "effector_u", "effector_v")) + "\n" + text + "\n")
    kinematics = KinematicsSettings(urdf=str(folder / "arm.urdf"), scale_prior=0.05)
    settings = Settings(body=BodySettings(unit=UNIT), kinematics=kinematics)
    result = pipeline.fit([folder / "poses.csv"], folder / "body.npz", settings)
    return folder, result


def test_scale_is_learned_and_reported_with_its_uncertainty(learned):
    folder, result = learned
    by_joint = {one.joint: one for one in offsets.learned_scales(files.load_body(folder / "body.npz"))}
    lift = by_joint["lift"]
    assert lift.identifiable and abs(lift.value - SCALE) < 2 * lift.std and lift.value > 2 * lift.std
    text = [one.text for one in result.findings]
    assert any(one.startswith("lift: its scale is off by +") and one.endswith("%") for one in text)
    assert all(abs(one.value) < 2 * one.std for one in by_joint.values() if one.identifiable and one is not lift)


def test_scale_is_printed_and_written(learned, run_cli, capsys):
    folder, _ = learned
    for name in ("zeros.yaml", "zeros.json"):
        assert run_cli("offsets", folder / "body.npz", "--json", "-o", folder / name) == 0
        printed = json.loads(capsys.readouterr().out)["results"][0]
        tables = {key: printed[key] for key in ("offsets", "scales")}
        assert YAML(typ="safe").load((folder / name).read_text()) == tables
        assert printed["scales"]["lift"]["unit"] == "1" and printed["scales"]["lift"]["identifiable"]
    assert run_cli("offsets", folder / "body.npz", "-o", folder / "new.urdf", "--urdf", folder / "arm.urdf") == 0
    both = capsys.readouterr()
    assert "lift   scale +" in both.out and "holds the zeros alone" in both.err
    assert run_cli("info", folder / "body.npz") == 0
    assert "scale lift: +" in capsys.readouterr().out


def test_storage_keeps_the_scale_and_names_inconsistent_fields(learned):
    folder, _ = learned
    found = files.load_body(folder / "body.npz")
    sense, x = found.senses["effector"], angles(5, 4)
    many, value = sense.predict(x), sense.means(x)[0]
    assert sense.rig.of_scales.stop == len(sense.theta) and np.array_equal(many[0], value)
    for k in range(5):
        for one, row in zip(sense.predict_one(x[k]), many, strict=True):
            np.testing.assert_allclose(one, row[k], rtol=1e-8, atol=1e-8)
    files.save(found, folder / "again.npz")
    assert (folder / "again.npz").read_bytes() == (folder / "body.npz").read_bytes()
    with np.load(folder / "body.npz") as stored:
        arrays = dict(stored)
    header = json.loads(str(arrays["header"]))
    links = header["senses"]["effector"]["kinematics"]
    for scales in ("known", None):
        links["scales"] = scales
        if scales is None:
            del links["scales"]
        np.savez(folder / "bad.npz", **(arrays | {"header": np.array(json.dumps(header))}))
        with pytest.raises(ModelError, match="kinematics.scales" if scales else "doubt"):
            files.load_body(folder / "bad.npz")


def test_update_starts_from_the_scale(learned):
    sense = files.load_body(learned[0] / "body.npz").senses["effector"]
    rig, theta = update._merge_rigs({"effector": sense})
    assert np.array_equal(theta, sense.theta) and len(rig.prior[0]) == len(theta)


def test_scales_are_fixed_without_a_prior(learned, run_cli, capsys):
    folder, _ = learned
    (folder / "robot.toml").write_text("[kinematics]\nscale_prior = 0.5\n")
    typed = ("fit", folder / "poses.csv", "-o", folder / "no.npz", "--config", folder / "robot.toml")
    assert run_cli(*typed) == 2 and "0 to 0.3" in capsys.readouterr().err
    plain = body.learn_body([features(30)], Settings(), {}).model
    with pytest.raises(ModelError, match="without a URDF"):
        offsets.learned_scales(plain)

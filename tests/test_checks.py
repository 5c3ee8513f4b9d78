"""Tracks that are not learned, and URDFs that are refused before images are read."""

import json

import numpy as np
import pytest

from bodylog.checks import select_features_to_learn
from bodylog.errors import ConfigError, ModelError
from bodylog.robot.model import check_urdf
from bodylog.settings import FitSettings, KinematicsSettings, Settings
from tests.body.boards import features
from tests.kinematics import robots
from tests.kinematics.robots import ARM, JOINTS


def table(path, names=JOINTS, count=40):
    rig, q = robots.rig(known=False), robots.angles(count)
    image = rig.see(rig.sights[0], robots.truth(rig), q).image[:, 0]
    rows = np.hstack([q, image, image + 5.0])
    head = ",".join([*names, "tip_u", "tip_v", "published_u", "published_v"])
    np.savetxt(path, rows, delimiter=",", header=head, comments="")
    return path


def test_excluded_track_is_not_learned(tmp_path, run_cli, capsys):
    log = table(tmp_path / "poses.csv")
    (tmp_path / "arm.urdf").write_text(ARM)
    for name, more in (("all", ()), ("some", ("--without", "published"))):
        assert run_cli("fit", log, "-o", tmp_path / f"{name}.npz", "--json", *more) == 0
        text = json.loads(capsys.readouterr().out)["results"][0]
        senses = set(text["body"]["senses"])
        assert senses == ({"tip", "published"} if name == "all" else {"tip"})


def test_excluded_feature_drops_its_tracks_and_checks_names():
    one = features(robots.angles(5))
    (kept,) = select_features_to_learn([one], Settings(fit=FitSettings(without=("board",))))
    assert not kept.tracks and not kept.boards and one.tracks
    with pytest.raises(ConfigError, match=r"\[fit\] without: found 'bord', possible: board.0, "):
        select_features_to_learn([one], Settings(fit=FitSettings(without=("bord",))))


def test_urdf_of_other_joints_is_refused_before_reading_images(tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM)
    chosen = Settings(kinematics=KinematicsSettings(urdf=str(tmp_path / "arm.urdf")))
    check_urdf([table(tmp_path / "poses.csv")], chosen)
    with pytest.raises(ModelError, match=r"none of the joints of .*other.csv \(a, b, c, d\) is in it; it has"):
        check_urdf([table(tmp_path / "other.csv", "abcd")], chosen)


def test_urdf_that_spells_joints_otherwise_is_named(tmp_path, run_cli, capsys):
    """The robot's surface matches names by their words; a marker does not, and the log has no images."""
    names = ("kPan", "kLift", "kElbow", "kWrist")
    spelt = dict(zip(JOINTS, ("pan_joint", "lift_joint", "elbow_joint", "wrist_joint"), strict=False))
    text = ARM
    for joint, other in spelt.items():
        text = text.replace(f'name="{joint}"', f'name="{other}"')
    (tmp_path / "arm.urdf").write_text(text)
    chosen = Settings(kinematics=KinematicsSettings(urdf=str(tmp_path / "arm.urdf")))
    log = table(tmp_path / "poses.csv", names)
    assert "kPan is pan_joint in" in str(check_urdf([log], chosen))
    assert run_cli("fit", log, "--urdf", tmp_path / "arm.urdf", "-o", tmp_path / "no.npz") == 65
    (line,) = capsys.readouterr().err.splitlines()
    assert "images" in line
    assert not (tmp_path / "no.npz").exists()

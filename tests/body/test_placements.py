"""The calibration of a body: cameras, markers, lenses and zeros with honest error bars, printed and written."""

import json

import numpy as np
import pytest

from bodylog import body
from bodylog.body import storage as files
from bodylog.body.kinematic.learn import learn_kinematics
from bodylog.body.kinematic.placements import calibration_of_body as calibrated
from bodylog.errors import UsageError
from bodylog.kinematics import urdf
from bodylog.kinematics.chain import chain_between
from bodylog.kinematics.rotations import invert_transform, vector_from_rotation
from bodylog.robot import calibration
from bodylog.settings import Settings
from tests.body.boards import features, image
from tests.body.kinematic_arms import OFFSETS, given
from tests.kinematics import robots
from tests.kinematics.bullet import ends_of
from tests.kinematics.robots import ARM


@pytest.fixture(scope="module")
def learned():
    explored = features(robots.angles(40))
    return learn_kinematics([explored], Settings(), body.learn_body([explored], Settings(), {}, None, True), given()).model


def test_camera_and_board_are_where_they_are(learned):
    found = calibrated(learned)
    rig = robots.board()
    on_hand = chain_between(urdf.parse_urdf(ARM, "arm"), "hand", "tool").fixed[0] @ rig.carriers[0].anchor
    truth = {"camera": invert_transform(rig.cameras[0].anchor), "board": on_hand}
    # the first joint's zero turns the camera, the last one's the board: both have no meaning beyond 0
    assert {one.joint for one in found.zeros if not one.identifiable} == {"pan", "wrist"}
    for one in (*found.cameras, *found.markers):
        off = one.pose[:3, 3] - truth[one.name][:3, 3]
        turn = vector_from_rotation(one.pose[:3, :3] @ truth[one.name][:3, :3].T)
        assert one.identifiable and (one.place_std < 0.02).all() and (one.turn_std < np.radians(1.0)).all()
        assert (np.abs(off) < 4.0 * one.place_std).all() and (np.abs(turn) < 4.0 * one.turn_std).all()
    lens = found.lenses[0]
    assert (np.abs(lens.focal - 600.0) < 4.0 * lens.focal_std).all() and (lens.focal_std < 10.0).all()


def test_printed_set_foretells_by_itself_better_than_what_needs_the_process_beside_it(learned):
    """Camera, lens, board and zeros as printed, those not identifiable at 0, on images that were not learned from."""
    found = calibrated(learned)
    sense = next(iter(learned.senses.values()))
    rig = sense.rig
    theta = sense.theta.copy()
    camera, board, lens = found.cameras[0].pose, found.markers[0].pose, found.lenses[0]
    for part, pose, anchor in (
        (rig.of_camera(0), invert_transform(camera), rig.cameras[0].anchor), (rig.of_carrier(0), board, rig.carriers[0].anchor),
    ):  # fmt: skip
        step = pose @ invert_transform(anchor)
        theta[part][:6] = np.concatenate([step[:3, 3], vector_from_rotation(step[:3, :3])])
    ratio = np.log(lens.focal[1] / lens.focal[0])
    theta[rig.of_lens(0)] = [np.log(lens.focal[0]), ratio, *lens.centre, *lens.distortion]
    theta[rig.of_joints] = [one.value if one.identifiable else 0.0 for one in found.zeros]
    q = robots.angles(50, seed=5)
    point = rig.sights[0].points
    number = int(np.argmin(np.abs(robots.board().sights[0].points - point).sum(axis=1)))
    true = image(q)[:, number]
    errors = [np.sqrt(np.mean((rig.see(rig.sights[0], at, q).image[:, 0] - true) ** 2)) for at in (theta, sense.theta)]
    assert errors[0] < 0.8 * errors[1]


def test_calibration_is_printed_and_written(learned, tmp_path, run_cli, capsys):
    from dataclasses import replace

    sized = {**learned.provenance, "image_sizes": {"camera": [640, 480]}}
    files.save(replace(learned, provenance=sized), tmp_path / "body.npz")
    files.save(learned, tmp_path / "unsized.npz")
    (tmp_path / "arm.urdf").write_text(ARM)
    assert run_cli("calibration", tmp_path / "body.npz", "--json", "-o", tmp_path / "all.json") == 0
    entry = json.loads(capsys.readouterr().out)["results"][0]
    found = entry["calibration"]
    assert json.loads((tmp_path / "all.json").read_text()) == found
    assert found["zeros"]["pan"]["value"] is None
    assert any("pan" in one["text"] and "cannot be separated" in one["text"] for one in entry["findings"])
    assert abs(found["zeros"]["lift"]["value"] - OFFSETS["lift"]) < 3 * found["zeros"]["lift"]["std"]
    camera = found["cameras"]["camera"]
    assert camera["link"] == "base" and len(camera["quaternion_xyzw"]) == 4 and camera["row_time_s"] is None
    assert found["markers"]["board"]["link"] == "hand"
    assert run_cli("calibration", tmp_path / "body.npz", "--camera-info", tmp_path / "lenses") == 0
    printed = capsys.readouterr().out
    assert "camera in base: " in printed and " mm\n" in printed and "lift   +" in printed
    x = camera["xyz_m"][0]
    assert f"static_transform_publisher --x {x:.6f} " in printed
    assert "--frame-id base --child-frame-id camera_optical_frame" in printed
    info = (tmp_path / "lenses" / "camera.yaml").read_text()
    assert info.startswith("image_width: 640\nimage_height: 480\n") and str(camera["focal_px"][0]) in info
    with pytest.raises(UsageError, match="the size of its images is not known"):
        calibration.write_lenses(tmp_path / "unsized.npz", calibrated(learned), tmp_path / "none")
    assert not (tmp_path / "none").exists()


CAMERA_FIELDS = {
    "link": str,
    "xyz_m": 3,
    "xyz_std_m": 3,
    "quaternion_xyzw": 4,
    "rotation_std_rad": 3,
    "focal_px": 2,
    "focal_std_px": 2,
    "centre_px": 2,
    "distortion": 2,
    "row_time_s": float,
    "row_time_std_s": float,
}
"""Fields of a camera that others read, with their type, or the count of their numbers."""
MARKER_FIELDS = {name: CAMERA_FIELDS[name] for name in ("link", "xyz_m", "xyz_std_m", "quaternion_xyzw", "rotation_std_rad")}


def test_printed_json_has_the_fields_that_others_read(learned, tmp_path, run_cli, capsys):
    """Numbers where they are known; null, and a sentence in the findings, where they are not identifiable."""
    files.save(learned, tmp_path / "body.npz")
    assert run_cli("calibration", tmp_path / "body.npz", "--json") == 0
    (result,) = json.loads(capsys.readouterr().out)["results"]
    values = result["calibration"]
    for kind, fields in (("cameras", CAMERA_FIELDS), ("markers", MARKER_FIELDS)):
        assert values[kind]
        for one in values[kind].values():
            for name, shape in fields.items():
                if name.startswith("row_time"):
                    assert one[name] is None or isinstance(one[name], float)  # None: not a log of a motion
                elif isinstance(shape, int):
                    assert len(one[name]) == shape and all(isinstance(value, float) for value in one[name])
                else:
                    assert isinstance(one[name], shape)
            np.testing.assert_allclose(np.linalg.norm(one["quaternion_xyzw"]), 1.0)
    assert isinstance(values["scales"], dict) and set(values["zeros"]) == set(robots.JOINTS)
    sentences = " ".join(one["text"] for one in result["findings"])
    for joint, zero in values["zeros"].items():
        assert zero["std"] >= 0.0 and isinstance(zero["identifiable"], bool)
        assert (zero["value"] is None) == (not zero["identifiable"]) == (joint in sentences)


def test_written_urdf_agrees_with_the_table(learned, tmp_path, run_cli):
    files.save(learned, tmp_path / "body.npz")
    (tmp_path / "arm.urdf").write_text(ARM)
    typed = ("calibration", tmp_path / "body.npz", "-o", tmp_path / "new.urdf")
    assert run_cli(*typed) == 2
    assert run_cli(*typed, "--urdf", tmp_path / "arm.urdf") == 0
    chain = chain_between(urdf.load_urdf(tmp_path / "new.urdf"), "base", "camera_optical_frame")
    np.testing.assert_allclose(chain.fixed[0], calibrated(learned).cameras[0].pose, atol=1e-12)
    pybullet = pytest.importorskip("pybullet")
    zeros = {one.joint: one.value for one in calibrated(learned).zeros if one.identifiable}
    angles = {"pan": 0.3, "lift": -0.5, "elbow": 0.8, "wrist": 0.1}
    turned = {name: angle + zeros.get(name, 0.0) for name, angle in angles.items()}
    after = ends_of(pybullet, (tmp_path / "new.urdf").read_text(), angles, tmp_path)
    before = ends_of(pybullet, ARM, turned, tmp_path)
    assert len(zeros) == 2
    np.testing.assert_allclose(after["tool"], before["tool"], atol=1e-6)
    np.testing.assert_allclose(after["camera_optical_frame"], calibrated(learned).cameras[0].pose, atol=1e-6)

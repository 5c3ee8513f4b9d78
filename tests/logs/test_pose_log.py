"""Tables of independent poses as logs: roles of columns, counts of rejects, and one-line refusals."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from bodylog.errors import EvidenceError, FormatError, InputError, LogError
from bodylog.kinematics import urdf
from bodylog.logs.formats import open_log
from bodylog.logs.tables import pose_log
from bodylog.logs.tables.pose_columns import assign_column_roles
from bodylog.logs.tables.table_file import read_table_file
from bodylog.pipeline import fit, ingest, observe
from bodylog.recording import recording
from bodylog.recording.robot_description import read_robot_description
from bodylog.robot.model import _build_camera_hints
from bodylog.settings import BodySettings, Settings
from tests.kinematics import robots

NAMES = ("pan", "lift")
Q = np.array([[0.1, -0.2], [3.1, 0.3], [-3.1, 0.4]])
UV = np.array([[10.0, 20.0], [np.nan, np.nan], [30.5, 40.25]])


def _csv(folder: Path, header: str, *rows: str, name: str = "poses.csv") -> Path:
    path = folder / name
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def _texts(path: Path) -> str:
    with open_log(path) as log:
        return " | ".join(f"{f.severity}: {f.text}" for f in log.findings)


@pytest.fixture
def table(tmp_path) -> Path:
    """Three poses; the tip is hidden in the second."""
    rows = ["1,0.1,-0.2,10,20,note,0.5", "2,3.1,0.3,,,note,0.5", "3,-3.1,0.4,30.5,40.25,,0.5"]
    return _csv(tmp_path, "pose,pan,lift,tip_u,tip_v,remark,tip_std", *rows)


def test_open_reads_joints_and_tracks(table):
    read_, found = observe(table, Settings())
    assert read_.facts.format == "csv" and read_.signals.poses and found.poses
    assert found.joints is not None and found.joints.names == NAMES
    np.testing.assert_array_equal(found.joints.values, Q)  # whole turns between poses stay: the poses are independent
    np.testing.assert_array_equal(found.tracks["tip"].values, UV)
    np.testing.assert_array_equal(found.tracks["tip"].std, np.full((3, 2), 0.5))
    np.testing.assert_array_equal(found.joints.t, [0, 1, 2])
    lines = _texts(table)
    assert "columns not used: remark, pose" in lines and "t is the row's number, counted from 0" in lines


def test_open_reads_parquet_and_yaml_as_csv(table, tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    columns = {"pan": Q[:, 0], "lift": Q[:, 1], "tip_u": UV[:, 0], "tip_v": UV[:, 1]}
    parquet.write_table(pyarrow.table(columns), tmp_path / "poses.parquet")
    rows = [
        {"joints": dict(zip(NAMES, q.tolist(), strict=True)), **({} if np.isnan(p[0]) else {"tip": p.tolist()})}
        for q, p in zip(Q, UV, strict=True)
    ]
    (tmp_path / "poses.yaml").write_text(json.dumps(rows))  # JSON is YAML
    for path in (tmp_path / "poses.parquet", tmp_path / "poses.yaml"):
        found = observe(path, Settings())[1]
        assert found.joints is not None and found.joints.names == NAMES
        np.testing.assert_array_equal(found.joints.values, Q)
        np.testing.assert_array_equal(found.tracks["tip"].values, UV)


def test_open_uses_a_column_of_times(tmp_path):
    path = _csv(tmp_path, "unix_s,pan", "1400834744.5,0.1", "1400834748.25,0.2")
    read_ = recording.read_recording(path, Settings())
    assert read_.signals.joints is not None and read_.start_ns == 1400834744500000000
    np.testing.assert_allclose(read_.signals.joints.t, [0, 3.75])
    path = _csv(tmp_path, "stamp_ms,pan", "0,0.1", "500,0.2")
    assert recording.read_recording(path, Settings()).signals.joints.t.tolist() == [0.0, 0.5]
    for times in (("5", "5"), ("1", ""), ("1", "1e6")):
        path = _csv(tmp_path, "t,pan", f"{times[0]},0.1", f"{times[1]},0.2")
        assert recording.read_recording(path, Settings()).signals.joints.t.tolist() == [0.0, 1.0]
        assert "t is the row's number" in _texts(path)


def test_poses_skip_columns_that_are_not_joints(tmp_path):
    header = "id;frame_index;arm_x;arm_y;arm_z;base_qx;base_qy;base_qz;base_qw;left_U;tip_u;pan;void"
    path = _csv(tmp_path, header, "1;2;3;4;5;0;0;0;1;0.7;5;0.2;", "2;2;3;4;5;0;0;0;1;0.8;5;0.3;")
    found = assign_column_roles(read_table_file(path, "csv"), str(path))
    assert list(found.joints) == ["left_U", "pan"] and list(found.tracks) == ["tracker/arm"]
    assert found.notes[-1].startswith("columns not used: id, frame_index, base_qx")


def test_points_in_space_are_tracks_of_a_tracker_in_metres(tmp_path):
    """Columns in mm by their span; a name with a frame keeps it; two axes of three are said to be none."""
    header = "pan,ball_x,ball_y,ball_z,ball_sigma,world/nest_x,world/nest_y,world/nest_z,half_x,half_z"
    path = _csv(tmp_path, header, "0.1,-300,20,1000,0.1,1,2,3,4,5", "0.2,500,30,,0.1,1.5,2,3,4,5", "0.3,400,30,900,0.1,1,2,4,4,5")
    found = assign_column_roles(read_table_file(path, "csv"), str(path))
    np.testing.assert_allclose(found.tracks["tracker/ball"], [[-0.3, 0.02, 1.0], [np.nan] * 3, [0.4, 0.03, 0.9]])
    np.testing.assert_allclose(found.std["tracker/ball"], 1e-4)
    np.testing.assert_allclose(found.tracks["world/nest"][0], [1.0, 2.0, 3.0])
    assert "tracker/ball: points that span 700 cannot be in m; they are taken in mm" in found.notes
    assert found.odd == ("half_x and half_z without half_y are no point in space",)
    track = recording.read_recording(path, Settings()).signals.features.tracks["tracker/ball"]
    assert (track.names, track.unit) == (("x", "y", "z"), "mm")
    np.testing.assert_allclose(track.values[0], [-300.0, 20.0, 1000.0])


@pytest.mark.parametrize(
    ("columns", "missing"),
    [
        ("ball_x,ball_y", "ball_x and ball_y without ball_z are no point in space"),
        ("ball_x,ball_z", "ball_x and ball_z without ball_y are no point in space"),
        ("ball_y,ball_z", "ball_y and ball_z without ball_x are no point in space"),
        ("ball_v", "ball_v without ball_u is no place in an image"),
        ("ball_std_x,ball_std_y,ball_std_z", "ball_std_z without ball_u and ball_v, or ball_x, ball_y and ball_z"),
        ("ball_sigma", "ball_sigma without ball_u and ball_v, or ball_x, ball_y and ball_z"),
    ],
)
def test_columns_that_lack_others_are_no_joints_and_fit_says_what_lacks(tmp_path, columns, missing):
    rows = [",".join(f"{0.1 * (k + m)}" for m in range(2 + columns.count(","))) for k in range(3)]
    path = _csv(tmp_path, f"pan,{columns}", *rows)
    found = assign_column_roles(read_table_file(path, "csv"), str(path))
    assert list(found.joints) == ["pan"] and not found.tracks
    with pytest.raises(EvidenceError, match=missing) as refused:
        fit([path], tmp_path / "body.npz")
    assert len(str(refused.value).splitlines()) == 1 and str(refused.value).count(str(path)) == 1


def test_deviations_along_some_axes_are_named_with_the_axis_that_lacks(tmp_path):
    path = _csv(tmp_path, "pan,tip_u,tip_v,tip_std_u", "0.1,1,2,0.3", "0.2,2,2,0.3")
    found = assign_column_roles(read_table_file(path, "csv"), str(path))
    assert found.odd == ("tip_std_u: no standard deviation of tip along v",)


def test_open_reports_and_converts_degrees(tmp_path):
    path = _csv(tmp_path, "pan", "-90", "0", "90")
    assert 'type: [body] unit = "deg"' in _texts(path)
    found = recording.read_recording(path, Settings(body=BodySettings(unit="deg"))).signals.joints.values
    np.testing.assert_allclose(found[:, 0], [-np.pi / 2, 0, np.pi / 2])


def test_open_counts_bad_cells_and_rows(tmp_path):
    path = _csv(tmp_path, "pan,lift", "0.1,0.2", "0.2,oops", "0.3,1e999", "0.4,0.1,7", "0.5", "0.6,0.3", "0.7,0.2")
    found = recording.read_recording(path, Settings())
    assert found.signals.joints.values.shape == (6, 2) and np.isnan(found.signals.joints.values[:, 1]).sum() == 3
    lines = _texts(path)
    assert "column lift: 2 cells are not finite numbers, e.g. 'oops'" in lines
    assert "1 rows have more than 2 cells and are left out" in lines and "1 rows have fewer than 2 cells" in lines
    assert lines.count("lost: ") == 2
    with pytest.raises(LogError, match="more than 2 cells"):
        open_log(path, strict=True)


def test_open_reads_images_beside_the_table(tmp_path):
    for k, place in enumerate([(40, 30), (80, 60)]):
        image = np.full((120, 160, 3), 60, np.uint8)
        cv2.circle(image, place, 9, (0, 255, 0), -1)
        cv2.imwrite(str(tmp_path / f"{k}.{'png' if k else 'bmp'}"), image)
    path = _csv(tmp_path, "picture,pan", "0.bmp,0.1", "1.png,0.2", "gone.png,0.3")
    read_, found = observe(path, Settings())
    np.testing.assert_allclose(found.tracks["effector"].values, [[40, 30], [80, 60]], atol=0.3)
    assert read_.facts.roles["camera"] == "/picture/compressed"
    assert any("1 images cannot be read: gone.png" in f.text and f.severity == "lost" for f in read_.facts.findings)


@pytest.mark.parametrize("form", ["bmp", "tiff", "ppm"])
def test_an_image_that_states_too_many_pixels_is_not_decoded(tmp_path, monkeypatch, form):
    cv2.imwrite(str(tmp_path / f"0.{form}"), np.zeros((100, 200, 3), np.uint8))
    path = _csv(tmp_path, "picture,pan", f"0.{form},0.1", f"0.{form},0.2")
    small = Settings(input=replace(Settings().input, max_image_mpx=0.01))
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("an image was decoded"))
    with open_log(path, False, small.input) as log:
        list(log.batches())
        texts = [finding.text for finding in log.findings if finding.severity == "lost"]
    asked = "an image of 200 x 100 pixels, more than 0.01 million; type in robot.toml: [input] max_image_mpx = 1"
    assert any(f"0.{form}: {asked}" in text for text in texts)


def test_ingest_keeps_poses_independent(table, tmp_path):
    ingest(table, tmp_path / "poses.mcap", Settings())
    read_, found = observe(tmp_path / "poses.mcap", Settings())
    assert read_.signals.poses and found.poses
    np.testing.assert_array_equal(found.joints.values, Q)
    np.testing.assert_array_equal(found.tracks["tip"].values, UV)


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("", "the file is empty"),
        ("\n\n", "no header"),
        ("0.1,0.2\n0.3,0.4\n", "it must name the columns"),
        ("pan,pan\n1,2\n", "column 'pan' occurs 2 times"),
        ("pan,lift\n", "the table has no rows"),
        ("pose,remark\n1,x\n", "no column is a joint"),
        ("pan\n\xff\xfe\n", "not a csv table"),
    ],
)
def test_open_refuses_other_tables_in_one_line(tmp_path, text, lines):
    path = tmp_path / "poses.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=lines) as caught:
        recording.read_recording(path, Settings())
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)


YAMLS = ("a: 1\n", "- 1\n- 2\n", "- {a: &x 1}\n- {a: *x}\n", "- {a: 1\n", "[]\n", "[" * 2000 + "\n")


@pytest.mark.parametrize("text", YAMLS, ids=range(len(YAMLS)))
def test_open_refuses_yaml_without_a_list_of_mappings(tmp_path, text):
    path = tmp_path / "poses.yaml"
    path.write_text(text)
    with pytest.raises(FormatError, match="not a yaml table"):
        open_log(path)


def test_open_refuses_a_damaged_parquet_file(tmp_path):
    pytest.importorskip("pyarrow")
    path = tmp_path / "poses.parquet"
    path.write_bytes(b"PAR1" + b"\0" * 20 + b"PAR1")
    with pytest.raises(InputError):
        open_log(path)


def test_a_unit_of_joints_does_not_convert_coordinates_of_a_frame(tmp_path):
    path = _csv(tmp_path, "tool_x,tool_y,tool_z,tool_qx,tool_qy,tool_qz,tool_qw,tip_u,tip_v", *(
        f"0.{k},0.2,0.3,0,0,{np.sin(0.1 * k)},{np.cos(0.1 * k)},{k},2" for k in range(1, 5)
    ))  # fmt: skip
    given = Settings()
    in_degrees = replace(given, body=replace(given.body, unit="deg"))
    plain, converted = (recording.read_recording(path, one).signals.joints for one in (given, in_degrees))
    assert plain is not None and converted is not None and plain.unit == converted.unit == "rad"
    np.testing.assert_array_equal(converted.values, plain.values)
    np.testing.assert_allclose(plain.values[:, 0], [0.1, 0.2, 0.3, 0.4])


@pytest.mark.parametrize("image", ["", "side.png"])
def test_columns_of_a_lens_are_the_cameras_and_no_joints(tmp_path, image):
    if image:
        cv2.imwrite(str(tmp_path / image), np.zeros((48, 64, 3), np.uint8))
    head = "pan,tip_u,tip_v,fx,fy,cx,cy,k1,p1" + (",picture" if image else "")
    rows = [f"0.{k},{k},2,633,634,320.5,240.5,-0.06,0.001" + (f",{image}" if image else "") for k in range(1, 5)]
    path = _csv(tmp_path, head, *rows)
    _, found = observe(path, Settings())
    assert found.joints.names == ("pan",)
    described = read_robot_description(path)
    (topic,) = described.cameras
    assert topic == ("/picture/camera_info" if image else "/camera/camera_info")
    robot = urdf.parse_urdf(robots.ARM, "arm")
    hint = _build_camera_hints(robot, [described], [found], Settings())[""]
    np.testing.assert_allclose(np.exp(hint.lens[0]) * np.array([1, np.exp(hint.lens[1])]), [633, 634])
    np.testing.assert_allclose(hint.lens[2:], [320.5, 240.5, -0.06, 0.0])
    assert hint.lens_std is None and hint.link is None


@pytest.mark.parametrize(
    ("lens", "words"),
    [
        (("633,633,1,1", "634,633,1,1"), r"column fx: found 633 to 634; possible: the same number in every row"),
        (("633,-1,1,1",) * 2, r"column fy: found -1; possible: px, above 0"),
    ],
)
def test_a_lens_that_cannot_be_is_refused(tmp_path, lens, words):
    path = _csv(tmp_path, "pan,fx,fy,cx,cy", *(f"0.1,{one}" for one in lens))
    with pytest.raises(LogError, match=words):
        open_log(path)


@pytest.mark.parametrize("row", ["{pan: 0.1, image: a.JPG}", '{pan: 0.1, image: "a\\x2ejpg"}'])
def test_image_files_of_a_yaml_table_are_found_however_they_are_spelt(tmp_path, row):
    (path := tmp_path / "poses.yaml").write_text(f"- {row}\n")
    assert [file.name.lower() for file in pose_log.image_files(path)] == ["a.jpg"]


def test_a_yaml_table_without_image_files_is_not_parsed_for_them(tmp_path, monkeypatch):
    monkeypatch.setattr(pose_log, "read_table_file", lambda *_: pytest.fail("it is parsed"))
    (path := tmp_path / "poses.yaml").write_text("- {pan: 0.1}\n")
    assert pose_log.image_files(path) == ()

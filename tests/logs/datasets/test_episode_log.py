"""HDF5 episodes, folders of tables, images and videos, and lone videos as logs."""

from pathlib import Path

import cv2
import numpy as np
import pytest

import bodylog.logs as logs
from bodylog.errors import InputError, LogError, UsageError
from bodylog.logs.formats import open_log
from bodylog.recording import facts
from bodylog.settings import Settings

from . import drawn
from .drawn import h5py


def texts(path: Path) -> str:
    with open_log(path) as log:
        for _ in log.batches():
            pass
        return " | ".join(f"{one.severity}: {one.text}" for one in log.findings)


def test_open_hdf5_reads_a_droid_trajectory_with_the_videos_beside(tmp_path):
    path = drawn.droid(tmp_path / "trajectory")
    with logs.open(path) as log:
        joints = log["/joint_states"]
        positions = np.arange(12)[:, None] * 0.01 + np.arange(7) * 0.1
        np.testing.assert_array_equal(joints.position, positions)
        np.testing.assert_array_equal(log["/action"].position, positions + 0.005)
        assert list(joints.name[0]) == [str(number) for number in range(7)]
        assert joints.header.stamp[0] == 1_678_453_535_000_000_000
        np.testing.assert_array_equal(np.diff(joints.header.stamp), np.full(11, 66_000_000))
        cameras = [topic.name for topic in log.topics if topic.name.endswith("/image")]
        assert len(cameras) == 1
        frames = list(log.frames(cameras[0]))
    assert len(frames) == 12
    assert frames[0].source_ns == 1_678_453_535_005_000_000


def test_open_hdf5_reads_robomimics_second_copy_of_a_step_once(tmp_path):
    path = drawn.robomimic(tmp_path / "demo.hdf5")
    with h5py.File(path, "a") as file:
        for name in ("robot0_joint_pos", "agentview_image"):
            file[f"data/demo_0/next_obs/{name}"] = file[f"data/demo_0/obs/{name}"][:]
    with logs.open(path) as log:
        assert not [topic.name for topic in log.topics if "next" in topic.name]


@pytest.mark.parametrize("packed", [False, True])
def test_open_hdf5_reads_an_aloha_episode(packed, tmp_path):
    path = drawn.aloha(tmp_path / "episode_0.hdf5", packed=packed)
    rows = np.arange(20)[:, None] * 0.1 + np.arange(14)
    with logs.open(path) as log:
        assert log.format == "hdf5"
        joints = log["/joint_states"]
        np.testing.assert_array_equal(joints.position, np.sin(rows))
        np.testing.assert_array_equal(log["/action"].position, np.cos(rows))
        assert joints.name[0][0] == "left_waist" and joints.name[0][13] == "right_gripper"
        np.testing.assert_array_equal(np.diff(joints.header.stamp), np.full(19, 20_000_000))
        frames = list(log.frames("/top/image/compressed" if packed else "/top/image"))
    assert len(frames) == 20
    for frame, image in zip(frames, drawn.images(20), strict=True):
        wanted = cv2.imdecode(cv2.imencode(".jpg", image)[1], cv2.IMREAD_COLOR) if packed else image
        np.testing.assert_array_equal(frame.image, wanted)
    assert "rows are dated at ALOHA's 50 Hz" in texts(path)


def test_open_hdf5_reads_robomimic_demonstrations(tmp_path):
    path = drawn.robomimic(tmp_path / "demos.hdf5")
    with logs.open(path) as log:
        assert "episode 0, the first of 3; for another, type: --episode 1" in log.findings[0].text
    with logs.open(path, episode=3) as log:
        joints = log["/joint_states"]
        assert joints.position[0, 0] == 3.0 and len(joints) == 12
        np.testing.assert_array_equal(np.diff(joints.header.stamp), np.full(11, 40_000_000))
        for frame, image in zip(log.frames("/agentview/image"), drawn.images(12, 3), strict=True):
            np.testing.assert_array_equal(frame.image, image)
    with pytest.raises(LogError, match=r"no episode 2; possible: 0, 1, 3"):
        open_log(Path(f"{path}#2"))
    with pytest.raises(LogError, match=r"no episode 1; the file holds one, number 0"):
        open_log(Path(f"{drawn.aloha(tmp_path / 'one.hdf5')}#1"))


def test_open_hdf5_uses_times_in_the_file(tmp_path):
    path = drawn.aloha(tmp_path / "a.hdf5")
    with h5py.File(path, "a") as file:
        file["observations/timestamp_ns"] = 1_700_000_000_000_000_001 + np.arange(20) * 30_000_007
    with logs.open(path) as log:
        assert log["/joint_states"].header.stamp[1] == 1_700_000_000_030_000_008
        assert "/timestamp_ns" not in {topic.name for topic in log.topics}


def _link(path: Path) -> None:
    with h5py.File(path, "a") as file:
        del file["observations/qpos"], file["action"], file["observations/images"]
        file["observations/qpos"] = h5py.ExternalLink("/etc/hostname", "/")


def _external(path: Path) -> None:
    (path.parent / "secret").write_bytes(bytes(20 * 64 * 64 * 3))
    with h5py.File(path, "a") as file:
        del file["observations/images/top"]
        shape = (20, 64, 64, 3)
        outside = [(str(path.parent / "secret"), 0, h5py.h5f.UNLIMITED)]
        file.create_dataset("observations/images/top", shape, np.uint8, external=outside)


def _huge(path: Path) -> None:
    with h5py.File(path, "a") as file:
        del file["observations/qpos"], file["observations/images/top"]
        file.create_dataset("observations/qpos", (1 << 40, 14), float, chunks=(1, 14))
        file.create_dataset("observations/images/top", (1 << 40, 1 << 20, 1 << 20, 3), np.uint8, chunks=(1, 8, 8, 3))


def test_open_hdf5_reads_nothing_outside_the_file(tmp_path):
    path = drawn.aloha(tmp_path / "a.hdf5")
    _external(path)
    with open_log(path) as log:
        assert "/top/image" not in {topic.name for topic in log.topics}
    _link(path)
    with pytest.raises(InputError) as refused:
        open_log(path)
    assert "no qpos, joint_pos, action or images" in str(refused.value)


def test_open_hdf5_checks_sizes_before_allocation(tmp_path):
    path = drawn.aloha(tmp_path / "a.hdf5")
    _huge(path)
    with open_log(path) as log:
        assert {topic.name for topic in log.topics} == {"/action", "/qvel"}
    assert f"observations/qpos: {1 << 40} rows" in texts(path)
    with h5py.File(path, "a") as file:
        del file["action"], file["observations/qvel"]
    with pytest.raises(LogError, match=rf"the times of {1 << 40} rows: .* \[input\] max_table_mb = "):
        open_log(path)


@pytest.mark.parametrize(
    ("name", "shape", "text"),
    [("qpos", (20, 1 << 24), "max_table_mb = "), ("images/top", (20, 1 << 20, 1 << 20, 3), "too large to be read")],
)
def test_open_hdf5_reports_wide_rows_and_large_images_as_lost(name, shape, text, tmp_path):
    path = drawn.aloha(tmp_path / "a.hdf5")
    with h5py.File(path, "a") as file:
        del file[f"observations/{name}"]
        file.create_dataset(f"observations/{name}", shape, np.uint8, chunks=(1, *(min(s, 64) for s in shape[1:])))
    assert f"lost: {path}: observations/{name}: " in texts(path) and text in texts(path)


@pytest.mark.parametrize("share", [0.02, 0.5, 0.95])
def test_open_hdf5_refuses_a_truncated_file_in_one_line(share, tmp_path):
    path = drawn.aloha(tmp_path / "a.hdf5")
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
    with pytest.raises(InputError) as refused:
        open_log(path)
    assert "the HDF5 file cannot be read" in str(refused.value) and "\n" not in str(refused.value)


def test_open_folder_reads_tables_images_and_videos(tmp_path):
    folder = drawn.mixed(tmp_path / "run")
    wanted = drawn.images(12)
    with logs.open(folder) as log:
        assert log.format == "tables" and len(log["/joint_states"]) == 24
        np.testing.assert_array_equal(log["/joint_states"].name[0], ["pan", "lift"])
        stamps = log["/side/image"].header.stamp - 1_700_000_000_000_000_000
        np.testing.assert_allclose(stamps / 1e9, np.arange(12) / 20 + 0.004 * (np.arange(12) % 2), atol=1e-6)
        frames = list(log.frames("/wrist/image/compressed"))
        films = list(log.frames("/side/image"))
    for frame, image in zip(frames, wanted, strict=True):
        np.testing.assert_array_equal(frame.image, image)
    for frame, image in zip(films, drawn.decoded(folder / "side.mp4"), strict=True):
        np.testing.assert_array_equal(frame.image, image)
    assert facts.describe_log(folder, Settings())["roles"]["joints"] == "/joint_states"


def test_open_video_takes_times_from_the_table_beside_it(tmp_path):
    folder = drawn.mixed(tmp_path / "run")
    with logs.open(folder / "side.mp4") as log:
        assert log["/side/image"].header.stamp[1] == pytest.approx(1_700_000_000_054_000_000, abs=1000)
    (folder / "side_timestamps.csv").unlink()
    with logs.open(folder / "side.mp4") as log:
        np.testing.assert_allclose(np.diff(log["/side/image"].header.stamp), 50_000_000, atol=2)


def test_open_folder_reads_no_images_outside_the_folder(tmp_path):
    folder = drawn.mixed(tmp_path / "run")
    (tmp_path / "outside.png").write_bytes((folder / "frames/000.png").read_bytes())
    lines = ["t,file", "0,../outside.png", f"1,{tmp_path / 'outside.png'}", "2,frames/000.png", "3,frames/none.png"]
    (folder / "wrist.csv").write_text("\n".join(lines))
    with open_log(folder) as log:
        (camera,) = (topic for topic in log.topics if topic.name.startswith("/wrist"))
        assert sum(len(batch.log_ns) for batch in log.batches((camera.id,))) == camera.messages == 4
        assert "3 of 4 images cannot be read" in log.findings[-1].text


def test_open_folder_reads_euroc_columns(tmp_path):
    folder = drawn.mixed(tmp_path / "run")
    (folder / "cam0").mkdir()
    (folder / "frames").rename(folder / "cam0" / "data")
    lines = [f"{1403636579763555584 + k * 50_000_000},{k:03d}.png" for k in range(12)]
    (folder / "cam0" / "data.csv").write_text("\n".join(["#timestamp [ns],filename", *lines]))
    (folder / "wrist.csv").unlink()
    with logs.open(folder) as log:
        assert len(list(log.frames("/cam0/image/compressed"))) == 12
        stamps = log["/cam0/image/compressed"].header.stamp
    assert abs(int(stamps[0]) - 1403636579763555584) < 1000


def test_open_folder_reports_a_table_without_times(tmp_path):
    folder = drawn.mixed(tmp_path / "run")
    (folder / "joints.csv").write_text("pan,lift\n1,2\n")
    assert "joints.csv: no column of times dates every row, so the table is not used" in texts(folder)
    (tmp_path / "only").mkdir()
    (tmp_path / "only/joints.csv").write_text("pan,lift\n1,2\n")
    with pytest.raises(LogError, match=r"no table with a column of times has images or joints"):
        open_log(tmp_path / "only")


def test_open_names_missing_packages(tmp_path, monkeypatch):
    import sys

    path = drawn.aloha(tmp_path / "a.hdf5")
    drawn.film(tmp_path / "a.mp4", drawn.images(3))
    for module in ("h5py", "av"):
        monkeypatch.setitem(sys.modules, module, None)
    for log in (path, tmp_path / "a.mp4"):
        with pytest.raises(UsageError, match=r"type: pip install 'bodylog\[datasets\]'"):
            open_log(log)


def test_rows_of_wide_chunks_are_read_a_few_at_a_time(tmp_path):
    """A chunk of seven images of 50 MB, of 64 x 1 px of each, and a file of a few kB, since nothing is stored."""
    from bodylog.logs.datasets import hdf5_file
    from bodylog.logs.limits import LIMITS

    with drawn.h5py.File(tmp_path / "wide.h5", "w") as file:
        wide = file.create_dataset("wide", (12, 4096, 4096, 3), "u1", chunks=(7, 64, 1, 3), compression="gzip")
        assert hdf5_file.rows_at_once(wide) == 1
        assert "524288 chunks; at most 262144 are read" in hdf5_file.explain_refused_dataset(wide, LIMITS)
        usual = file.create_dataset("usual", (500, 480, 640, 3), "u1", chunks=(1, 480, 640, 3))
        assert hdf5_file.rows_at_once(usual) == 4 and hdf5_file.explain_refused_dataset(usual, LIMITS) is None

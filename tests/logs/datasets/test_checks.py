"""The examination names what is wrong with a dataset, and nothing in a sound one."""

from pathlib import Path

import numpy as np
import pytest

from bodylog.logs.conversion.examination import examine_log_file

from . import drawn

REAL = Path(__file__).parents[4] / "shared" / "real" / "so101"


def texts(path: Path) -> list[str]:
    return [one.text for one in examine_log_file(path) if one.severity != "info"]


def _dataset(folder: Path, pictures: np.ndarray | None = None, codec: str = "libx264", **columns: object) -> Path:
    """A dataset of one episode of 60 rows, with other images or columns."""
    drawn.v21(folder, [60], length=60)
    if pictures is not None:
        drawn.film(folder / f"videos/chunk-000/{drawn.CAMERA}/episode_000000.mp4", pictures, codec)
    if columns:
        table = drawn.columns(0, 60) | {name.replace("_", "."): values for name, values in columns.items()}
        drawn.table(folder / "data/chunk-000/episode_000000.parquet", table)
    return folder


@pytest.mark.parametrize("source", [drawn.v21, drawn.v30])
def test_examine_finds_nothing_in_a_sound_dataset(source, tmp_path):
    assert texts(source(tmp_path / "set", [60, 40])) == []


@pytest.mark.parametrize("codec", ["libx264", "libsvtav1", "mpeg4"])
def test_checks_report_a_black_camera(codec, tmp_path):
    rng = np.random.default_rng(0)
    dark = rng.integers(0, 12, (60, 64, 64, 3), np.uint8)
    (text,) = texts(_dataset(tmp_path / "set", dark, codec))
    assert text.endswith("set#0: /top/image: the camera is black in all 60 images")


def test_checks_report_when_a_camera_is_black(tmp_path):
    pictures = drawn.images(60)
    pictures[20:40] = 3
    found = texts(_dataset(tmp_path / "set", pictures))
    assert any("the camera is black from 1.00 to 1.95 s (20 images)" in text for text in found)


@pytest.mark.parametrize("codec", ["libx264", "libsvtav1"])
def test_checks_report_when_a_camera_is_frozen(codec, tmp_path):
    pictures = drawn.images(60)
    pictures[10:35] = pictures[10]
    (text,) = texts(_dataset(tmp_path / "set", pictures, codec))
    assert "/top/image: the camera is frozen from 0.50 to" in text and "while joints move" in text


def test_checks_report_repeated_images_once(tmp_path):
    pictures = np.repeat(drawn.images(4), 15, axis=0)
    (text,) = texts(_dataset(tmp_path / "set", pictures))
    assert "the camera is frozen 4 times, 2.6 s of 3.0 s while joints move" in text


def test_checks_accept_a_static_camera_with_static_joints(tmp_path):
    pictures, q = drawn.images(60), drawn.angles(60)
    pictures[10:40] = pictures[10]
    q[10:40] = q[10]
    assert texts(_dataset(tmp_path / "set", pictures, observation_state=q)) == []


def test_checks_report_constant_wrapping_and_invalid_joints(tmp_path):
    q = drawn.angles(60).astype(float)
    q[:, 2] = 0.25
    q[:, 0] = (np.linspace(3.0, 3.5, 60) + np.pi) % (2 * np.pi) - np.pi
    q[50, 1] = np.nan
    found = " | ".join(texts(_dataset(tmp_path / "set", observation_state=q)))
    assert "/joint_states: gripper is constant throughout" in found
    assert "/joint_states: shoulder wraps around 1 times" in found and "elbow wraps" not in found
    assert "1 of 180 readings are not finite numbers" in found


def test_checks_report_wrong_lengths_and_gaps(tmp_path):
    t = np.arange(60) / drawn.FPS
    t[30:] += 1.5
    folder = _dataset(tmp_path / "set", timestamp=t)
    drawn.info(folder, "v2.1", [60], total_episodes=7, total_frames=99)
    (folder / "meta/episodes.jsonl").write_text(
        '{"episode_index": 0, "length": 80}\n{"episode_index": 1, "length": 5}\n'
    )
    found = " | ".join(texts(folder))
    for text in (
        "info.json says total_episodes 7, 2 are listed",
        "2 episodes are listed, the tables of 1 are there",
        "info.json says total_frames 99, the episodes listed have 85",
        "the dataset lists 80 rows for this episode, its table holds 60",
        "/joint_states: 1 gaps in time, the first of 1.55 s at 1.45 s",
        "the video's times and the table's drift apart, by up to 1.5 s",
    ):
        assert text in found


def test_examine_reports_each_episode(tmp_path):
    folder = drawn.v30(tmp_path / "set", [60, 40])
    drawn.film(
        folder / f"videos/{drawn.CAMERA}/chunk-000/file-000.mp4",
        np.concatenate([drawn.images(60), np.zeros((40, 64, 64, 3), np.uint8)]),
        "libsvtav1",
    )
    assert texts(folder) == [f"{folder}#1: /top/image: the camera is black in all 40 images"]
    assert texts(Path(f"{folder}#0")) == []


def test_examine_reports_the_black_camera_of_a_real_dataset():
    if not REAL.is_dir():
        pytest.skip("the real SO-101 dataset (../shared/real/so101) is not at hand")
    found = texts(Path(f"{REAL}#0"))
    assert f"{REAL}#0: /cam0/image: the camera is black in all 348 images" in found
    assert any("/cam1/image: the camera is frozen 18 times, 16.5 s of 18.7 s" in text for text in found)
    assert any("drift apart, by up to 1.36 s" in text for text in found)
    assert not any("black" in text or "frozen" in text for text in texts(Path(f"{REAL}#1")))

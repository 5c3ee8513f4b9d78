"""Datasets as people have them: each is written without bodylog, and examined whole."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.logs.datasets import drawn
from tests.logs.datasets.drawn import h5py

ROWS = 30
Rows = dict[str, dict[str, Any]]


@pytest.fixture
def examine(run_cli: Any, capsys: Any) -> Callable[..., tuple[int, Rows, str]]:
    """The exit code, the episodes' rows by name, and the whole's verdict of a dataset."""

    def run(*datasets: Path) -> tuple[int, Rows, str]:
        code = run_cli("doctor", *datasets, "--delay", "off", "--json")
        *rows, whole = json.loads(capsys.readouterr().out)["results"]
        return code, {row["name"]: row for row in rows}, "\n".join(whole["verdict"])

    return run


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drawn.v21(tmp_path_factory.mktemp("formats") / "set", [ROWS, ROWS])


def copy_dataset(source: Path, to: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """A copy of a dataset whose info.json is changed."""
    folder = Path(shutil.copytree(source, to))
    path = folder / "meta/info.json"
    known = json.loads(path.read_text())
    change(known)
    path.write_text(json.dumps(known))
    return folder


def test_joints_without_names_are_known_by_their_numbers(sound: Path, tmp_path: Path, examine: Any) -> None:
    def forget_names(info: dict[str, Any]) -> None:
        for feature in ("observation.state", "action"):
            info["features"][feature]["names"] = None

    code, rows, _ = examine(copy_dataset(sound, tmp_path / "set", forget_names))
    assert code == 0
    for row in rows.values():
        assert {f"longest_repeat/{number}" for number in range(3)} <= set(row["scores"])


@pytest.mark.parametrize("stored", [True, False])
def test_v2_0_has_one_file_of_statistics(sound: Path, tmp_path: Path, examine: Any, stored: bool) -> None:
    folder = copy_dataset(sound, tmp_path / "set", lambda info: info.update(codebase_version="v2.0"))
    path = folder / "meta/stats.json"
    if stored:
        values = np.concatenate([drawn.angles(ROWS, number) for number in range(2)])
        figures = {name: getattr(values, name)(axis=0).tolist() for name in ("min", "max", "mean", "std")}
        path.write_text(json.dumps({"observation.state": figures}))
    code, rows, verdict = examine(folder)
    assert code == 0 and len(rows) == 2
    assert (f"{path}: there is no such file" in verdict) == (not stored)
    assert "episodes_stats" not in verdict


def test_a_missing_video_is_named_in_the_verdict(sound: Path, tmp_path: Path, examine: Any) -> None:
    folder = copy_dataset(sound, tmp_path / "set", lambda _: None)
    video = folder / f"videos/chunk-000/{drawn.CAMERA}/episode_000001.mp4"
    video.unlink()
    code, rows, verdict = examine(folder)
    assert code == 3
    assert [row["exit_code"] for row in rows.values()] == [0, 3]
    assert f"1 of 2 episodes lost a part: set_1; {drawn.CAMERA}: {video}: there is no such file" in verdict


@pytest.mark.parametrize("form", ["video", "image"])
@pytest.mark.parametrize("there", [True, False])
def test_depth_is_named_as_unread_and_its_missing_files_too(
    sound: Path, tmp_path: Path, examine: Any, form: str, there: bool
) -> None:
    name = "observation.images.top_depth" if form == "image" else "observation.images.range"
    flag = {"info": {"video.is_depth_map": True}} if form == "video" else {}
    about = {"dtype": form, "shape": [64, 64, 1], "names": ["height", "width", "channels"], **flag}
    folder = copy_dataset(sound, tmp_path / "set", lambda info: info["features"].update({name: about}))
    if there:
        for number in range(2):
            film = f"episode_{number:06d}.mp4"
            own = folder / f"videos/chunk-000/{drawn.CAMERA}" / film
            depth = folder / f"videos/chunk-000/{name}" / film
            depth.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(own, depth)
    code, rows, verdict = examine(folder)
    texts = [one["text"] for one in rows["set_0"]["findings"] if one["severity"] == "info"]
    assert any(text.endswith(f"{name}: depth, which is not read") for text in texts)
    assert code == (3 if form == "video" and not there else 0)
    assert ("lost a part" in verdict) == (code == 3)


@pytest.mark.parametrize("name", ["observations/images_depth/depth", "observations/images/wrist_depth"])
def test_depth_in_hdf5_is_no_row_of_numbers(tmp_path: Path, examine: Any, name: str) -> None:
    for number in range(2):
        path = drawn.aloha(tmp_path / f"episode_{number}.hdf5", ROWS)
        with h5py.File(path, "a") as file:
            file["observations/qpos"][:] += number
            file[name] = np.full((ROWS, 64, 64), 1500, np.uint16)
    code, rows, _ = examine(tmp_path)
    assert code == 0
    texts = [one["text"] for row in rows.values() for one in row["findings"]]
    assert sum(f"{name}: depth of shape ({ROWS}, 64, 64), which is not read" in text for text in texts) == 2


def test_episodes_of_two_robots_are_compared_with_their_own(tmp_path: Path, examine: Any) -> None:
    """The joints of one are elsewhere by 90 in all its episodes, and only one of them stands out there."""
    other = copy_dataset(
        drawn.v21(tmp_path / "raw", [ROWS] * 7), tmp_path / "other", lambda info: info.update(robot_type="tall")
    )
    shutil.rmtree(tmp_path / "raw")
    for number in range(7):
        columns = drawn.columns(number, ROWS)
        for feature in ("observation.state", "action"):
            columns[feature] = 0.01 * columns[feature] + np.float32(95.0 if number == 4 else 90.0)
        drawn.table(other / f"data/chunk-000/episode_{number:06d}.parquet", columns)
    code, _, verdict = examine(drawn.v21(tmp_path / "first", [ROWS] * 8), other)
    assert code == 0
    assert "the episodes are of 2 robots, and each is compared with its own: drawn with 3 joints" in verdict
    assert "tall with 3 joints (elbow, gripper, shoulder) in 7 of them: other_0, other_1, other_2" in verdict
    assert "perhaps for good reasons: other_4 " in verdict and not re.search(r"(first|other_[0-35-6])\S* \(", verdict)


def test_a_robot_with_more_joints_in_some_episodes_is_another(sound: Path, tmp_path: Path, examine: Any) -> None:
    folder = copy_dataset(sound, tmp_path / "set", lambda _: None)
    columns = drawn.columns(1, ROWS)
    for feature in ("observation.state", "action"):
        columns[feature] = np.hstack([columns[feature]] * 2)
    drawn.table(folder / "data/chunk-000/episode_000001.parquet", columns)
    code, _, verdict = examine(folder)
    assert code == 0
    assert "drawn with 6 joints (0, 1, 2 and 3 more) in 1 of them: set_1" in verdict


@pytest.mark.parametrize("kind", ["aloha", "robomimic", "droid", "mcap"])
def test_folders_of_episodes_are_datasets(
    tmp_path: Path, sound: Path, run_cli: Any, capsys: Any, examine: Any, kind: str
) -> None:
    folder = tmp_path / "set"
    folder.mkdir()
    if kind == "robomimic":
        drawn.robomimic(folder / "demos.hdf5", (0, 1), ROWS)
    for number in range(0 if kind == "robomimic" else 2):
        if kind == "aloha":
            drawn.aloha(folder / f"episode_{number}.hdf5", ROWS + number)
        elif kind == "droid":
            drawn.droid(folder / f"success/day_{number}", ROWS + number)
        else:
            assert run_cli("ingest", f"{sound}#{number}", "-o", folder / f"{number}.mcap") == 0
    capsys.readouterr()
    code, rows, verdict = examine(folder)
    assert code == 0 and verdict.startswith("2 episodes")
    expected = {
        "aloha": ["episode_0.hdf5", "episode_1.hdf5"],
        "robomimic": ["demos.hdf5_0", "demos.hdf5_1"],
        "droid": ["day_0_trajectory.h5", "day_1_trajectory.h5"],
        "mcap": ["0.mcap", "1.mcap"],
    }
    assert list(rows) == expected[kind]
    cameras = {"aloha": "top", "robomimic": "agentview", "droid": "cam_22008760", "mcap": "camera"}
    joint = {"aloha": "right_waist", "mcap": "elbow"}.get(kind, "3")
    for row in rows.values():
        assert f"rate/{cameras[kind]}" in row["scores"]
        assert f"longest_repeat/{joint}" in row["scores"]


POSITIONS, IMAGES, ACTIONS = (
    f"data/demo_2/{name}" for name in ("obs/robot0_joint_pos", "obs/agentview_image", "actions")
)
SPOILT: dict[str, tuple[Callable[[Any], object], str]] = {
    "no joints": (lambda file: file.pop(POSITIONS), "observation.state: missing in 1 of 3 episodes: set.hdf5_2"),
    "no actions": (lambda file: file.pop(ACTIONS), "action: missing in 1 of 3 episodes: set.hdf5_2"),
    "no images": (lambda file: file.pop(IMAGES), "agentview: missing in 1 of 3 episodes: set.hdf5_2"),
    "smaller images": (
        lambda file: file.update({IMAGES: file.pop(IMAGES)[:, :32]}),
        "agentview: images of 64 x 64 in 2 of 3 episodes, of 64 x 32 in set.hdf5_2",
    ),
    "images that are no bytes": (
        lambda file: file.update({IMAGES: file.pop(IMAGES)[:] / 2.0}),
        "agentview: missing in 1 of 3 episodes: set.hdf5_2",
    ),
}
"""What is done to the last episode of a file, and the sentence on it."""


@pytest.mark.parametrize("name", SPOILT)
def test_what_one_episode_of_an_hdf5_file_lacks_is_named_in_the_verdict(
    tmp_path: Path, examine: Any, name: str
) -> None:
    spoil, says = SPOILT[name]
    path = drawn.robomimic(tmp_path / "set.hdf5", (0, 1, 2), 30)
    with drawn.h5py.File(path, "r+") as file:
        part = {one: file[one][:] for one in (POSITIONS, IMAGES, ACTIONS)}
        spoil(part)
        for one in (POSITIONS, IMAGES, ACTIONS):
            del file[one]
            if one in part:
                file[one] = part[one]
    _, _, text = examine(path)
    assert says in text


@pytest.mark.parametrize("damage", ["empty", "cut", "noise"])
def test_a_damaged_log_of_a_folder_has_a_row_that_says_so(tmp_path: Path, examine: Any, damage: str) -> None:
    folder = tmp_path / "set"
    folder.mkdir()
    for number in range(3):
        drawn.aloha(folder / f"{number}.hdf5", 30 + number)
    data = (folder / "1.hdf5").read_bytes()
    left = {"empty": b"", "cut": data[: len(data) // 2], "noise": np.random.default_rng(0).bytes(len(data))}
    (folder / "1.hdf5").write_bytes(left[damage])
    code, rows, text = examine(folder)
    assert code == 65 and "1 cannot be used: 1.hdf5" in text
    assert rows["1.hdf5"]["exit_code"] == 65 and "1.hdf5" in rows["1.hdf5"]["error"]

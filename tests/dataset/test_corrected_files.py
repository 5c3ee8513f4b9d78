"""`bodylog fix`: images are paired with the rows that they show, the rest stays byte for byte."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bodylog.dataset.corrected_files import write_corrected
from bodylog.dataset.remedies import CameraDelay, Remedy
from bodylog.io import episodes
from bodylog.logs.datasets.lerobot import open_lerobot
from bodylog.settings import Settings
from tests.logs.datasets import drawn

av = pytest.importorskip("av", reason="PyAV is not installed: pip install 'bodylog[datasets]'")
parquet = drawn.parquet

ROWS = (24, 30, 20)
FPS = drawn.FPS
SIDE = "observation.images.side"


def tree(folder: Path) -> dict[str, bytes]:
    """All files of a folder."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def with_second_camera(folder: Path) -> Path:
    """The dataset with a camera more, whose videos are those of the first."""
    path = folder / "meta/info.json"
    info = json.loads(path.read_text())
    info["features"][SIDE] = info["features"][drawn.CAMERA]
    path.write_text(json.dumps(info))
    shutil.copytree(
        folder / f"videos/chunk-000/{drawn.CAMERA}", folder / f"videos/chunk-000/{SIDE}"
    )
    return folder


def squares(folder: Path, number: int, camera: str) -> list[int]:
    """The place of the drawn square, which tells the source's frame, in each image of an episode
    as bodylog reads it, and its row's time."""
    with open_lerobot(episodes.name_episode(folder, number)) as log:
        one = next(c for c in log.cameras.values() if c.metadata["bodylog.feature"] == camera)
        images = [image for _, image in one.read()]
        assert len(images) == len(one.ns)
        state = next(s for s in log.signals if s.topic == "/joint_states")
        assert np.abs(one.ns[: len(state.ns)] - state.ns).max() < 1_000
    return [_column(image) for image in images if image is not None]


def _column(image: Any) -> int:
    """The left edge of the bright green square."""
    green = image[8:24, :, 1].astype(int) - image[8:24, :, 0]
    return int(np.argmax(green.mean(axis=0) > 80))


def frames_of(rows: int) -> list[int]:
    """The left edges of the squares in the frames of a drawn video."""
    return [(2 * row) % 40 for row in range(rows)]


def states(folder: Path, number: int) -> np.ndarray:
    """The states of an episode, by pyarrow alone."""
    files = sorted((folder / "data").rglob("*.parquet"))
    tables = [parquet.read_table(path) for path in files]
    parts = [
        np.array(table.column("observation.state").to_pylist())[
            np.array(table.column("episode_index")) == number
        ]
        for table in tables
    ]
    return np.concatenate([part.reshape(-1, 3) for part in parts])


@pytest.fixture(params=["v2.1", "v3.0"])
def dataset(request: Any, tmp_path: Path) -> Path:
    """Three short episodes in either layout."""
    folder = tmp_path / "source"
    return drawn.v21(folder, list(ROWS)) if request.param == "v2.1" else drawn.v30(
        folder, list(ROWS), "libx264"
    )


def test_nothing_to_do_leaves_every_file_as_it_is(dataset: Path, tmp_path: Path) -> None:
    (dataset / "README.md").write_text("mine")
    before = tree(dataset)
    write_corrected(dataset, [Remedy(k) for k in range(3)], tmp_path / "out", "mark", Settings())
    assert tree(dataset) == before
    after = tree(tmp_path / "out")
    assert after.pop("meta/fixed.json")
    assert after == before


@pytest.mark.parametrize("late", [3, -2])
def test_rows_get_the_images_that_show_them(dataset: Path, tmp_path: Path, late: int) -> None:
    out = tmp_path / "out"
    delays = {drawn.CAMERA: CameraDelay(late / FPS + 0.004, 0.002)}
    before = tree(dataset)
    sentences = write_corrected(
        dataset, [Remedy(k, "", delays) for k in range(3)], out, "keep", Settings()
    )
    assert tree(dataset) == before
    assert any("4 ± 2 ms are left" in text for text in sentences)
    for number, rows in enumerate(ROWS):
        first, end = max(0, -late), rows - max(0, late)
        assert np.array_equal(states(out, number), states(dataset, number)[first:end])
        seen = squares(out, number, drawn.CAMERA)[: end - first]
        wanted = frames_of(rows)[first + late : end + late]
        assert np.abs(np.array(seen) - wanted).max() <= 1
    films = {name: data for name, data in tree(out).items() if name.endswith(".mp4")}
    assert films == {name: data for name, data in before.items() if name.endswith(".mp4")}


def test_cameras_with_different_delays_are_each_paired(tmp_path: Path) -> None:
    source = with_second_camera(drawn.v21(tmp_path / "source", list(ROWS)))
    delays = {drawn.CAMERA: CameraDelay(3 / FPS, 0.002), SIDE: CameraDelay(1 / FPS, 0.002)}
    write_corrected(
        source, [Remedy(k, "", delays) for k in range(3)], tmp_path / "out", "keep", Settings()
    )
    for number, rows in enumerate(ROWS):
        for camera, late in ((drawn.CAMERA, 3), (SIDE, 1)):
            seen = squares(tmp_path / "out", number, camera)
            wanted = frames_of(rows)[late : rows - 3 + late]
            assert np.abs(np.array(seen) - wanted).max() <= 1
        for camera, late in ((drawn.CAMERA, 3), (SIDE, 1)):
            wanted = frames_of(rows)[late : rows - 3 + late]
            found = squares_by_loader(tmp_path / "out", number, camera)
            assert np.abs(np.array(found) - wanted).max() <= 1


def squares_by_loader(folder: Path, number: int, camera: str) -> list[int]:
    """As `squares`, looked up as LeRobot's loader does it: the frame whose time is the row's
    `timestamp`, in a shared video from `from_timestamp` on, to its tolerance of 0.1 ms."""
    files = sorted((folder / "data").rglob("*.parquet"))
    tables = [parquet.read_table(path) for path in files]
    t = np.concatenate(
        [np.array(one["timestamp"])[np.array(one["episode_index"]) == number] for one in tables]
    )
    film = folder / f"videos/chunk-000/{camera}/episode_{number:06d}.mp4"
    if not film.is_file():
        film = folder / f"videos/{camera}/chunk-000/file-000.mp4"
        listed = parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
        t = t + listed[number][f"videos/{camera}/from_timestamp"]
    with av.open(str(film)) as container:
        frames = [(one.time, one.to_ndarray(format="bgr24")) for one in container.decode(video=0)]
    times = np.array([time for time, _ in frames])
    nearest = [int(np.abs(times - at).argmin()) for at in t]
    assert np.abs(times[nearest] - t).max() < 1e-4
    return [_column(frames[k][1]) for k in nearest]


@pytest.mark.parametrize("late", [0, 3, 4])
def test_images_of_a_lower_rate_are_those_that_lerobots_loader_gives(
    dataset: Path, tmp_path: Path, late: int
) -> None:
    """Every second row is kept, of a film whose frames are stored twice; one episode is left out."""
    pictures = [drawn.images(rows, number)[np.arange(rows) // 2 * 2] for number, rows in enumerate(ROWS)]
    shared = dataset / f"videos/{drawn.CAMERA}/chunk-000/file-000.mp4"
    if shared.is_file():
        drawn.film(shared, np.concatenate(pictures))
    else:
        for number, some in enumerate(pictures):
            name = f"videos/chunk-000/{drawn.CAMERA}/episode_{number:06d}.mp4"
            drawn.film(dataset / name, some)
    delays = {drawn.CAMERA: CameraDelay(late / FPS, 0.002)} if late else {}
    remedies = [
        Remedy(0, "", delays, (drawn.CAMERA,)),
        Remedy(1, "it stands out"),
        Remedy(2, "", delays, (drawn.CAMERA,)),
    ]
    write_corrected(dataset, remedies, tmp_path / "out", "drop", Settings())
    for number, rows in enumerate((ROWS[0], ROWS[2])):
        found = squares_by_loader(tmp_path / "out", number, drawn.CAMERA)
        assert len(found) == len(states(tmp_path / "out", number)) >= (rows - late) // 2
        assert squares(tmp_path / "out", number, drawn.CAMERA) == pytest.approx(found, abs=1)
        # the picture is that of the frame `late` on, and its next copy is the next row's
        assert np.diff(found)[:4] == pytest.approx([4] * 4, abs=1)


def test_an_episode_left_out_is_listed_and_the_others_numbered_again(
    dataset: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    remedies = [Remedy(0), Remedy(1, "its camera is black"), Remedy(2)]
    sentences = write_corrected(dataset, remedies, out, "mark", Settings())
    assert "2 of 3 episodes are kept" in sentences
    listed = [json.loads(text) for text in (out / "meta/excluded.jsonl").read_text().splitlines()]
    assert listed == [{"episode_index": 1, "reason": "its camera is black"}]
    info = json.loads((out / "meta/info.json").read_text())
    assert (info["total_episodes"], info["total_frames"]) == (2, ROWS[0] + ROWS[2])
    assert np.array_equal(states(out, 1), states(dataset, 2))
    assert len(squares(out, 1, drawn.CAMERA)) == ROWS[2]
    tables = [parquet.read_table(path) for path in sorted((out / "data").rglob("*.parquet"))]
    index = np.concatenate([np.array(table.column("index")) for table in tables])
    assert index.tolist() == list(range(ROWS[0] + ROWS[2]))


@pytest.mark.parametrize("copies", [2, 4])
def test_repeated_frames_are_marked_or_their_rows_dropped(tmp_path: Path, copies: int) -> None:
    source = drawn.v21(tmp_path / "source", [40])
    pictures = drawn.images(40)[np.arange(40) // copies * copies]
    drawn.film(source / f"videos/chunk-000/{drawn.CAMERA}/episode_000000.mp4", pictures)
    remedy = Remedy(0, "", {}, (drawn.CAMERA,))
    write_corrected(source, [remedy], tmp_path / "marked", "mark", Settings())
    table = parquet.read_table(tmp_path / "marked/data/chunk-000/episode_000000.parquet")
    marks = np.array(table.column("repeated.top"))
    repeats = np.arange(40) % copies > 0
    assert marks[repeats].all() and not marks[~repeats].any()
    info = json.loads((tmp_path / "marked/meta/info.json").read_text())
    assert info["features"]["repeated.top"]["dtype"] == "bool"
    write_corrected(source, [remedy], tmp_path / "half", "drop", Settings())
    assert json.loads((tmp_path / "half/meta/info.json").read_text())["fps"] == FPS / copies
    assert np.array_equal(states(tmp_path / "half", 0), states(source, 0)[::copies])
    shown = squares(tmp_path / "half", 0, drawn.CAMERA)
    assert shown == pytest.approx(frames_of(40)[::copies], abs=1)


def test_statistics_are_those_of_the_rows_left(tmp_path: Path) -> None:
    source = drawn.v21(tmp_path / "source", [24])
    values = states(source, 0)
    own = {"min": values.min(0).tolist(), "q50": np.median(values, 0).tolist(), "count": [24]}
    line = {"episode_index": 0, "stats": {"observation.state": own}}
    (source / "meta/episodes_stats.jsonl").write_text(json.dumps(line) + "\n")
    delays = {drawn.CAMERA: CameraDelay(0.25, 0.01)}
    write_corrected(source, [Remedy(0, "", delays)], tmp_path / "out", "keep", Settings())
    stored = json.loads((tmp_path / "out/meta/episodes_stats.jsonl").read_text())
    found, left = stored["stats"]["observation.state"], values[:19]
    assert found["count"] == [19]
    assert found["min"] == pytest.approx(left.min(0))
    assert found["q50"] == pytest.approx(np.median(left, 0))


def test_the_command_says_what_it_did_and_refuses_what_it_cannot(
    tmp_path: Path, run_cli: Any, capsys: Any
) -> None:
    source = drawn.v21(tmp_path / "source", [24, 24, 24])
    film = source / f"videos/chunk-000/{drawn.CAMERA}/episode_000002.mp4"
    film.write_bytes(film.read_bytes()[:200])
    before = tree(source)
    assert run_cli("fix", source, "-o", tmp_path / "out", "--jobs", "1") == 0
    printed = capsys.readouterr().out
    assert "2 of 3 episodes are kept" in printed and "episode 2 is left out" in printed
    assert tree(source) == before
    assert run_cli("fix", source, "-o", tmp_path / "out") == 2
    assert "already exists" in capsys.readouterr().err
    assert run_cli("fix", source, "-o", source / "inside") == 2
    (tmp_path / "logs").mkdir()
    drawn.aloha(tmp_path / "logs/one.hdf5")
    assert run_cli("fix", tmp_path / "logs", "-o", tmp_path / "other") == 2
    assert "bodylog convert" in capsys.readouterr().err
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left == ["logs", "out", "source"]


def test_a_failure_leaves_nothing(tmp_path: Path) -> None:
    from bodylog.errors import LogError

    source = drawn.v21(tmp_path / "source", [24])
    with pytest.raises(LogError, match="all of its 1 episodes are left out"):
        write_corrected(source, [Remedy(0, "bad")], tmp_path / "out", "mark", Settings())
    assert [path.name for path in tmp_path.iterdir()] == ["source"]

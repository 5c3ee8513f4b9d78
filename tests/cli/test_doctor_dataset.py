"""`bodylog doctor DATASET`: rows, exit codes, resume, shards, bounds, tables and the page."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'bodylog[datasets]'")

from tests.dataset import arm_dataset
from tests.logs.datasets import drawn

COUNT = 3
DAMAGES: dict[str, Callable[[Path], object]] = {
    "gone": Path.unlink,
    "cut": lambda file: file.write_bytes(file.read_bytes()[: file.stat().st_size // 3]),
    "noise": lambda file: file.write_bytes(np.random.default_rng(0).bytes(file.stat().st_size)),
}
LOST = ("has an existing table", "without a table: ", "there are no tables")
"""Sentences on files that are not there, beside those that name the file."""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Short episodes of still pictures: the machinery is tested, not the checks."""
    rows = 40
    still = np.full((rows, 32, 48, 3), 90, np.uint8)
    still[:, 8:20, 10:30] = 200
    parts = []
    for number in range(COUNT):
        angles = arm_dataset.motion(number)(np.arange(rows) / arm_dataset.FPS)
        parts.append(arm_dataset.Episode(angles, angles, still))
    return arm_dataset.write(tmp_path_factory.mktemp("data") / "arm", parts)


def tree(folder: Path) -> dict[str, bytes]:
    """All files of a folder."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def test_every_episode_has_a_result_and_the_dataset_one_more(dataset: Path, run_cli: Any, capsys: Any) -> None:
    assert run_cli("doctor", dataset, "--json") == 0
    results = json.loads(capsys.readouterr().out)["results"]
    assert [one["name"] for one in results] == ["arm_0", "arm_1", "arm_2", "dataset"]
    assert results[-1]["scores"]["episodes"] == {"value": 3.0, "unit": "1"}
    assert "3 episodes" in results[-1]["verdict"][0]
    assert results[0]["scores"]["repeated/top"]["value"] == 1.0


def test_a_range_of_episodes_is_examined(dataset: Path, run_cli: Any, capsys: Any) -> None:
    assert run_cli("doctor", dataset, "--episodes", "1:3", "--json", "--delay", "off") == 0
    names = [one["name"] for one in json.loads(capsys.readouterr().out)["results"]]
    assert names == ["arm_1", "arm_2", "dataset"]
    assert run_cli("doctor", dataset, "--episodes", "7:9") == 2
    assert "possible: 0 to 2" in capsys.readouterr().err


def test_shards_and_resumed_runs_leave_the_bytes_of_one_run(dataset: Path, tmp_path: Path, run_cli: Any) -> None:
    typed = ("doctor", dataset, "--delay", "off", "-o")
    assert run_cli(*typed, tmp_path / "whole") == 0
    whole = tree(tmp_path / "whole")
    assert {"results.jsonl", "junit.xml", "report.html", "dataset.json"} <= whole.keys()
    for shard in ("1/2", "2/2"):
        assert run_cli(*typed, tmp_path / "shards", "--shard", shard) == 0
    assert tree(tmp_path / "shards") == whole
    (tmp_path / "whole" / "arm_1" / "row.json").unlink()
    kept = (tmp_path / "whole" / "arm_0" / "row.json").stat().st_mtime_ns
    assert run_cli(*typed, tmp_path / "whole", "--resume") == 0
    assert tree(tmp_path / "whole") == whole
    assert (tmp_path / "whole" / "arm_0" / "row.json").stat().st_mtime_ns == kept


@pytest.mark.parametrize("left", [".bodylog-batch", "*/row.json"])
def test_a_killed_run_resumes_to_the_same_bytes(dataset: Path, tmp_path: Path, run_cli: Any, left: str) -> None:
    """Killed with its workers once the folder exists, or once an episode is done."""
    typed = ["doctor", str(dataset), "--delay", "off", "-o"]
    assert run_cli(*typed, tmp_path / "whole") == 0
    out = tmp_path / "killed"
    command = [sys.executable, "-m", "bodylog_cli", *typed, str(out), "--jobs", "2"]
    process = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and not any(out.glob(left)):
        time.sleep(0.002)
    assert process.poll() is None
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert not (out / "dataset.json").exists()
    assert run_cli(*typed, out, "--resume") == 0
    assert tree(out) == tree(tmp_path / "whole")


@pytest.mark.parametrize("damaged", ["table", "video"])
def test_a_damaged_file_gives_a_row_that_says_so(dataset: Path, tmp_path: Path, run_cli: Any, damaged: str) -> None:
    copy = shutil.copytree(dataset, tmp_path / "copy")
    pattern = "**/episode_000001.parquet" if damaged == "table" else "**/episode_000001.mp4"
    (file,) = copy.glob(pattern)
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 3])
    code = run_cli("doctor", copy, "-o", tmp_path / "out", "--delay", "off")
    rows = [json.loads(text) for text in (tmp_path / "out/results.jsonl").read_text().splitlines()]
    codes = [row["exit_code"] for row in rows]
    assert codes == ([0, 65, 0] if damaged == "table" else [0, 3, 0])
    assert code == codes[1]
    row_error = rows[1]["error"] or " ".join(text for severity, text in rows[1]["findings"] if severity == "lost")
    assert "episode_000001" in row_error


@pytest.fixture(scope="module", params=["v21", "v30"])
def complete_dataset(request: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of two episodes with every file that its version has."""
    folder = getattr(drawn, request.param)(tmp_path_factory.mktemp("complete") / "set", [12, 12])
    known = json.loads((folder / "meta/info.json").read_text())
    (folder / "meta/info.json").write_text(json.dumps(known | {"total_tasks": 1}))
    own = [summarise_columns(drawn.angles(12, number)) for number in range(2)]
    rows = [{"episode_index": number, "stats": {"observation.state": one}} for number, one in enumerate(own)]
    if request.param == "v21":
        text = "".join(f"{json.dumps(row)}\n" for row in rows)
        (folder / "meta/episodes_stats.jsonl").write_text(text)
    else:
        whole = summarise_columns(np.concatenate([drawn.angles(12, number) for number in range(2)]))
        (folder / "meta/stats.json").write_text(json.dumps({"observation.state": whole}))
    return folder


def summarise_columns(values: np.ndarray) -> dict[str, Any]:
    """A feature's statistics, as LeRobot stores them."""
    found = {name: getattr(values, name)(axis=0).tolist() for name in ("min", "max", "mean", "std")}
    return {**found, "count": [len(values)]}


def read_verdict(dataset: Path, run_cli: Any, capsys: Any) -> tuple[int, str]:
    """The exit code of `doctor`, and all that rows, verdict and refusal say."""
    code = run_cli("doctor", dataset, "--delay", "off", "--json")
    out, err = capsys.readouterr()
    results = json.loads(out)["results"] if out else []
    return code, json.dumps(results) + err


def test_a_complete_dataset_lacks_nothing(complete_dataset: Path, run_cli: Any, capsys: Any) -> None:
    code, text = read_verdict(complete_dataset, run_cli, capsys)
    assert code == 0 and "no such file" not in text and not any(one in text for one in LOST)
    assert "info.json" not in text and "stats" not in text


@pytest.mark.parametrize("damage", DAMAGES)
def test_any_file_that_is_damaged_is_named(
    complete_dataset: Path, tmp_path: Path, run_cli: Any, capsys: Any, damage: str
) -> None:
    for number, file in enumerate(sorted(one for one in complete_dataset.rglob("*") if one.is_file())):
        copy = shutil.copytree(complete_dataset, tmp_path / f"{number}")
        DAMAGES[damage](copy / file.relative_to(complete_dataset))
        code, text = read_verdict(copy, run_cli, capsys)
        assert code in (0, 3, 65), text
        assert file.name in text or any(one in text for one in LOST), file
        assert code != 0 or damage == "gone" or "stats" in file.name, file


def change_info(**changes: Any) -> Callable[[Path], object]:
    """Change info.json, or of it the features that are named."""

    def change(folder: Path) -> None:
        path = folder / "meta/info.json"
        known = json.loads(path.read_text())
        for name, value in changes.items():
            known["features"].get({"state": "observation.state", "top": drawn.CAMERA}.get(name), known).update(value)
        path.write_text(json.dumps(known))

    return change


def change_table(name: str, change: Callable[[Any], list[Any] | None]) -> Callable[[Path], object]:
    """Change a column of the last episode's table; none: drop it."""

    def rewrite(folder: Path) -> None:
        path = sorted(folder.glob("data/**/*.parquet"))[-1]
        table = drawn.parquet.read_table(path)
        values = change(table.column(name).to_pylist())
        place = table.schema.get_field_index(name)
        left = table.remove_column(place)
        new = left if values is None else left.append_column(name, drawn.arrow.array(values))
        drawn.parquet.write_table(new, path)

    return rewrite


def write_video(size: tuple[int, int] = drawn.SIZE, fps: int = drawn.FPS) -> Callable[[Path], object]:
    """Write the last video again, with images of another size or another rate."""

    def rewrite(folder: Path) -> None:
        path = sorted(folder.glob("videos/**/*.mp4"))[-1]
        pictures = np.array([np.resize(one, (size[1], size[0], 3)) for one in drawn.decoded(path)])
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(drawn, "FPS", fps)
            drawn.film(path, pictures)

    return rewrite


CONTRADICTIONS: dict[str, tuple[Callable[[Path], object], str]] = {
    "rate": (change_info(info={"fps": 10}), "rows are 0.05 s apart (20 Hz), info.json says fps 10"),
    "size": (change_info(top={"shape": [480, 640, 3]}), "info.json declares images of 640 x 480, the video has 64 x 64"),
    "type": (change_info(state={"dtype": "int64"}), "observation.state: info.json says dtype int64, the table holds float"),
    "no type": (change_info(state={"dtype": "flat32"}), "info.json says dtype 'flat32', which is not read; possible: float16"),
    "text": (change_info(state={"dtype": "string"}), "info.json says dtype 'string', and no numbers are read; possible: float16"),
    "images": (change_info(top={"dtype": "image"}), "has no such column; possible: video"),
    "width": (change_info(state={"shape": [7]}), "observation.state: info.json declares 7 numbers, the table holds 3"),
    "names": (change_info(state={"names": ["a", "b"]}), "info.json lists 2 names of 3 numbers"),
    "place": (change_info(info={"data_path": "data/x.parquet"}), "by data_path in info.json the first is "),
    "video's size": (write_video(size=(96, 48)), "info.json declares images of 64 x 64, the video has 96 x 48"),
    "video's rate": (write_video(fps=10), "the video has 10 frames a second, info.json says fps 20"),
    "stamps": (change_table("timestamp", lambda t: [2.0 * one for one in t]), "(10 Hz), info.json says fps 20"),
    "narrow": (change_table("observation.state", lambda q: [one[:2] for one in q]), "declares 3 numbers, the table holds 2"),
    "texts": (change_table("observation.state", lambda q: list(map(str, q))), "the table holds no such numbers"),
    "no stamps": (change_table("timestamp", lambda _: None), "timestamp: info.json declares it, the table has no such column"),
    "task": (change_table("task_index", lambda k: [9] * len(k)), "task_index is 9 in some rows"),
}
"""What files hold otherwise than the dataset's lists say, and what names it."""


@pytest.mark.parametrize("name", CONTRADICTIONS)
def test_what_a_dataset_lists_otherwise_than_its_files_hold_is_named_in_the_verdict(
    complete_dataset: Path, tmp_path: Path, run_cli: Any, capsys: Any, name: str
) -> None:
    contradict, says = CONTRADICTIONS[name]
    copy = shutil.copytree(complete_dataset, tmp_path / "copy")
    contradict(copy)
    code = run_cli("doctor", copy, "--delay", "off", "--json")
    whole = json.loads(capsys.readouterr().out)["results"]
    verdict = [*whole[-1]["verdict"], *(one["error"] or "" for one in whole)]
    assert any(says in text for text in verdict), verdict
    assert code in (0, 3, 65)


def test_a_film_of_another_episode_is_named(tmp_path: Path, run_cli: Any, capsys: Any) -> None:
    folder = drawn.v21(tmp_path / "set", [12, 12, 12])
    videos = sorted(folder.glob("videos/**/*.mp4"))
    shutil.copy(videos[2], videos[0])
    assert run_cli("doctor", folder, "--delay", "off", "--json") == 0
    verdict = json.loads(capsys.readouterr().out)["results"][-1]["verdict"]
    assert any("top: set_0 and set_2 have the same film" in text for text in verdict), verdict


def test_a_broken_bound_ends_with_4_and_is_a_failure(dataset: Path, tmp_path: Path, run_cli: Any) -> None:
    bounds = ("--fail-if", "repeated/top>0.5", "--fail-if", "episodes<4")
    assert run_cli("doctor", dataset, "-o", tmp_path / "out", "--delay", "off", *bounds) == 4
    suite = ET.parse(tmp_path / "out/junit.xml").getroot()
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("4", "4", "0")
    assert run_cli("doctor", dataset, "--delay", "off", "--fail-if", "repeated/top>1.5") == 0


@pytest.mark.parametrize(("share", "code", "trained"), [(0.5, 4, False), (1.5, 0, True)])
def test_a_job_of_ci_stops_at_a_broken_bound(
    dataset: Path, tmp_path: Path, share: float, code: int, trained: bool
) -> None:
    """The next line of a job runs only where the bound holds; what is broken is on standard error."""
    steps = f'''
"$1" -m bodylog_cli doctor "$2" --delay off -o "$3/out" --fail-if 'repeated/top>{share}'
touch "$3/trained"
'''
    job = ["bash", "-e", "-c", steps, "job", sys.executable, str(dataset), str(tmp_path)]
    done = subprocess.run(job, capture_output=True, text=True)
    assert done.returncode == code
    assert (tmp_path / "trained").exists() == trained
    assert ("repeated/top" in done.stderr) == (not trained)
    failures = [one.get("message") for one in ET.parse(tmp_path / "out/junit.xml").getroot().iter("failure")]
    assert len(failures) == (0 if trained else 1 + COUNT)
    assert all("repeated/top is 1, bound broken" in (text or "") for text in failures)


def test_a_bound_that_no_episode_measures_is_refused(dataset: Path, run_cli: Any, capsys: Any) -> None:
    assert run_cli("doctor", dataset, "--delay", "off", "--fail-if", "delay/side>0.1") == 2
    assert "no episode has this score" in capsys.readouterr().err


def test_page_and_table_are_written_without_a_folder(dataset: Path, tmp_path: Path, run_cli: Any) -> None:
    page, table = tmp_path / "report.html", tmp_path / "episodes.csv"
    assert run_cli("doctor", dataset, "--delay", "off", "-o", page, "--csv", table) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["episodes.csv", "report.html"]
    text = page.read_text()
    assert "arm_2" in text and "<svg" in text and "wrist" in text
    assert text.count("joints: /joint_states is used") == 1 and "<td>3: arm_0, arm_1, arm_2</td>" in text
    lines = table.read_text().splitlines()
    assert len(lines) == 1 + COUNT and "repeated/top" in lines[0]


def test_an_episode_that_is_a_copy_is_named(dataset: Path, tmp_path: Path, run_cli: Any, capsys: Any) -> None:
    copy = shutil.copytree(dataset, tmp_path / "copy")
    tables = copy / "data/chunk-000"
    arm_dataset.write_episode(copy, 1, _first(dataset))
    assert len(list(tables.iterdir())) == COUNT
    assert run_cli("doctor", copy, "--delay", "off") == 0
    assert "copy_0 and copy_1 are the same episode" in capsys.readouterr().out


def _first(dataset: Path) -> arm_dataset.Episode:
    rows = 40
    angles = arm_dataset.motion(0)(np.arange(rows) / arm_dataset.FPS)
    return arm_dataset.Episode(angles, angles, np.full((rows, 32, 48, 3), 90, np.uint8))


def test_statistics_that_do_not_match_are_named(dataset: Path, tmp_path: Path, run_cli: Any, capsys: Any) -> None:
    copy = shutil.copytree(dataset, tmp_path / "copy")
    wrong = {"min": [0.0] * 3, "max": [0.1] * 3, "mean": [0.05] * 3, "std": [0.01] * 3, "count": [40]}
    row = {"episode_index": 2, "stats": {"observation.state": wrong}}
    (copy / "meta/episodes_stats.jsonl").write_text(json.dumps(row) + "\n")
    assert run_cli("doctor", copy, "--delay", "off") == 0
    assert "does not match the data: observation.state of episode 2" in capsys.readouterr().out


def test_options_of_datasets_are_refused_of_one_log(dataset: Path, tmp_path: Path, run_cli: Any) -> None:
    assert run_cli("doctor", f"{dataset}#0", "--csv", tmp_path / "x.csv") == 2
    assert run_cli("doctor", dataset, "--resume") == 2


@pytest.mark.parametrize("name", ["report.html", "dataset.json"])
def test_a_file_that_no_examination_wrote_is_not_replaced(
    dataset: Path, tmp_path: Path, run_cli: Any, name: str
) -> None:
    (tmp_path / name).write_text("mine")
    assert run_cli("doctor", dataset, "--delay", "off", "-o", tmp_path) == 2
    assert (tmp_path / name).read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_body_without_a_surface_is_refused_before_any_episode(
    dataset: Path, robot: Path, run_cli: Any, capsys: Any
) -> None:
    assert run_cli("doctor", dataset, "--body", robot / "body.npz") == 65
    assert "it has no surface of a robot, by which episodes are judged; type: bodylog fit" in capsys.readouterr().err

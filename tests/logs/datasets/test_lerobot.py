"""LeRobot folders as logs: every episode's values, images and times; damage is reported in one line."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import bodylog.logs as logs
from bodylog.errors import InputError, LogError, UsageError
from bodylog.io import episodes
from bodylog.io.outputs import Output, guard_outputs
from bodylog.logs.formats import files_of, hash_log, open_log
from bodylog.recording import facts, recording
from bodylog.settings import Settings

from . import drawn

LENGTHS = [12, 9, 15]
REAL = Path(__file__).parents[4] / "shared" / "real" / "so101"


@pytest.fixture(scope="module")
def old(tmp_path_factory) -> Path:
    return drawn.v21(tmp_path_factory.mktemp("v21") / "set", LENGTHS)


@pytest.fixture(scope="module")
def new(tmp_path_factory) -> Path:
    return drawn.v30(tmp_path_factory.mktemp("v30") / "set", LENGTHS)


@pytest.fixture
def copied(old, tmp_path) -> Path:
    """A dataset to break."""
    return Path(shutil.copytree(old, tmp_path / "set"))


def texts(path: Path) -> str:
    with open_log(path) as log:
        for _ in log.batches():
            pass
        return " | ".join(f"{one.severity}: {one.text}" for one in log.findings)


@pytest.mark.parametrize("number", range(3))
@pytest.mark.parametrize("form", ["old", "new"])
def test_open_gives_rows_and_images_of_an_episode(form, number, request):
    folder = request.getfixturevalue(form)
    rows, first = LENGTHS[number], sum(LENGTHS[:number])
    with logs.open(folder, episode=number) as log:
        joints, action, done = log["/joint_states"], log["/action"], log["/next/done"]
        np.testing.assert_array_equal(joints.position, drawn.angles(rows, number))
        np.testing.assert_array_equal(action.position, drawn.angles(rows, number) + np.float32(0.01))
        np.testing.assert_array_equal(joints.name[0], drawn.JOINTS)
        np.testing.assert_array_equal(done.data[:, 0], np.arange(rows) == rows - 1)
        t = (np.arange(rows) / drawn.FPS).astype(np.float32).astype(float)
        np.testing.assert_array_equal(joints.header.stamp, 1_000_000_000 + np.rint(t * 1e9))
        assert [one.value.data for one in log.messages(["/task"])] == ["push"]
        frames = list(log.frames("/top/image"))
    np.testing.assert_array_equal([one.source_ns for one in frames], joints.header.stamp)
    file = f"videos/chunk-000/{drawn.CAMERA}/episode_{number:06d}.mp4"
    path = folder / (file if form == "old" else f"videos/{drawn.CAMERA}/chunk-000/file-000.mp4")
    wanted = drawn.decoded(path)[0 if form == "old" else first :][:rows]
    assert len(frames) == rows
    for frame, image in zip(frames, wanted, strict=True):
        np.testing.assert_array_equal(frame.image, image)


def test_open_defaults_to_the_first_existing_episode(old, copied):
    (copied / "data/chunk-000/episode_000000.parquet").unlink()
    for folder, number in ((old, 0), (copied, 1)):
        with logs.open(folder) as log:
            assert len(log["/joint_states"]) == LENGTHS[number]
            assert f"episode {number}, the first of" in log.findings[0].text
    with pytest.raises(LogError, match=r"no episode 0; possible: 1, 2"):
        logs.open(copied, episode=0)


def test_open_names_an_episode_that_is_listed_twice(copied):
    with (copied / "meta/episodes.jsonl").open("a") as listed:
        listed.write('{"episode_index": 1, "length": 3}\n')
    with logs.open(copied, episode=1) as log:
        named = [one.text for one in log.findings if one.severity == "warning"]
    assert any("episodes.jsonl lists episode 1 more than once; its last entry is taken" in one for one in named)
    with logs.open(copied, episode=0) as log:
        assert not any("more than once" in one.text for one in log.findings)


def test_open_selects_an_episode_by_number(old, tmp_path):
    assert episodes.split_episode_name(Path(f"{old}#2")) == (old, 2) == episodes.split_episode_name(Path(f"{old}/#2"))
    assert episodes.split_episode_name(tmp_path / "set#2") == (tmp_path / "set#2", None)
    (tmp_path / "run#2.mcap").touch()
    assert episodes.split_episode_name(tmp_path / "run#2.mcap")[1] is None
    assert episodes.expand_episode_range(Path(f"{old}#0-2")) == tuple(Path(f"{old}#{n}") for n in range(3))
    with pytest.raises(UsageError, match="a range runs from the smaller number"):
        episodes.expand_episode_range(Path(f"{old}#5-2"))
    with pytest.raises(LogError, match=r"is not a dataset, so it has no episodes"):
        open_log(Path(f"{tmp_path}/run#2.mcap#1"))


def test_digest_covers_only_the_episodes_files(old, copied):
    before = [hash_log(Path(f"{copied}#{number}")) for number in range(3)]
    assert before == [hash_log(Path(f"{old}#{number}")) for number in range(3)] and len(set(before)) == 3
    drawn.table(copied / "data/chunk-000/episode_000001.parquet", drawn.columns(1, 8))
    after = [hash_log(Path(f"{copied}#{number}")) for number in range(3)]
    assert after[1] != before[1] and after[0] == before[0] and after[2] == before[2]
    assert files_of(copied) == files_of(Path(f"{copied}#0"))


def test_guard_refuses_an_output_inside_a_dataset(old):
    for place in (old / "new.mcap", old / "meta" / "info.json"):
        with pytest.raises(UsageError, match="input"):
            guard_outputs([Path(f"{old}#1")], [Output(place)])


@pytest.mark.parametrize("declared", [{"unit": "degrees"}, {"names": ["a_deg", "b_deg", "c_deg"]}])
def test_unit_converts_declared_degrees(copied, declared):
    info = json.loads((copied / "meta/info.json").read_text())
    info["features"]["observation.state"] |= declared
    (copied / "meta/info.json").write_text(json.dumps(info))
    read = recording.read_recording(copied, Settings())
    assert read.signals.joints is not None and read.signals.joints.unit == "rad"
    np.testing.assert_allclose(read.signals.joints.values, np.deg2rad(drawn.angles(12).astype(float)), rtol=1e-15)
    assert "degrees, as" in texts(copied)
    with logs.open(copied) as log:
        np.testing.assert_array_equal(log["/joint_states"].position, drawn.angles(12))


@pytest.mark.parametrize(
    ("values", "unit", "text"),
    [
        ([[4090, 100], [3, 101], [9, 102]], "counts", "encoder counts, whole numbers from 3 to 4090"),
        ([[88.5, 10.0], [95.0, 11.0], [-99.0, 13.0]], "unknown", "their unit is not declared"),
        ([[0.5, 1.0], [0.6, 3.1], [0.7, -3.1]], "rad", "rad, the values, -3.1 to 3.1, look like it"),
    ],
)
def test_unit_reports_its_guess_from_values(copied, values, unit, text):
    rows = np.array(values, float)
    info = json.loads((copied / "meta/info.json").read_text())
    info["features"]["observation.state"] |= {"shape": [2], "names": ["pan", "lift"]}
    (copied / "meta/info.json").write_text(json.dumps(info))
    table = drawn.columns(0, 3) | {"observation.state": rows}
    drawn.table(copied / "data/chunk-000/episode_000000.parquet", table)
    found = facts.describe_log(copied, Settings())
    assert found["unit"] == unit and text in " ".join(one["text"] for one in found["findings"])
    read = recording.read_recording(copied, Settings())
    turn = {"counts": 4096.0, "unknown": np.inf, "rad": 2 * np.pi}[unit]
    steps = np.diff(rows, axis=0)
    moved = steps - np.where(np.abs(steps) > turn / 2, np.sign(steps) * turn, 0.0) if np.isfinite(turn) else steps
    assert read.signals.joints is not None
    np.testing.assert_allclose(np.diff(read.signals.joints.values, axis=0), moved)


def test_frames_take_row_times_and_report_drift(copied):
    table = drawn.columns(0, 12) | {"timestamp": np.arange(12) * 0.06}
    drawn.table(copied / "data/chunk-000/episode_000000.parquet", table)
    with logs.open(copied) as log:
        np.testing.assert_array_equal(log["/top/image"].header.stamp, 1_000_000_000 + np.arange(12) * 60_000_000)
    assert "the video's times and the table's drift apart, by up to 0.11 s" in texts(copied)


def test_info_decodes_no_image(old, monkeypatch):
    monkeypatch.setattr("bodylog.logs.datasets.video.iterate_video_images", lambda *_: pytest.fail("an image was decoded"))
    assert facts.describe_log(old, Settings())["roles"] == {"joints": "/joint_states", "camera": "/top/image"}


def test_open_knows_other_names_of_state_and_action(copied):
    info = json.loads((copied / "meta/info.json").read_text())
    features = info["features"]
    features["state"], features["actions"] = features.pop("observation.state"), features.pop("action")
    features["state"]["names"] = {"motors": list(drawn.JOINTS)}
    (copied / "meta/info.json").write_text(json.dumps(info))
    table = drawn.columns(0, 12)
    table["state"], table["actions"] = table.pop("observation.state"), table.pop("action")
    drawn.table(copied / "data/chunk-000/episode_000000.parquet", table)
    with logs.open(copied) as log:
        np.testing.assert_array_equal(log["/joint_states"].position, drawn.angles(12))
        np.testing.assert_array_equal(log["/action"].name[0], drawn.JOINTS)
        assert len(log["/action"]) == 12


def test_open_knows_names_in_a_nested_list(copied):
    info = json.loads((copied / "meta/info.json").read_text())
    info["features"]["observation.state"]["names"] = [list(drawn.JOINTS)]
    (copied / "meta/info.json").write_text(json.dumps(info))
    with logs.open(copied) as log:
        np.testing.assert_array_equal(log["/joint_states"].name[0], drawn.JOINTS)


def test_open_passes_on_images_in_the_table(copied):
    import cv2

    wanted = drawn.images(12)
    info = json.loads((copied / "meta/info.json").read_text())
    info["features"][drawn.CAMERA]["dtype"] = "image"
    (copied / "meta/info.json").write_text(json.dumps(info))
    cells = [{"bytes": cv2.imencode(".png", image)[1].tobytes(), "path": None} for image in wanted]
    drawn.table(copied / "data/chunk-000/episode_000000.parquet", drawn.columns(0, 12) | {drawn.CAMERA: cells}, 5)
    with logs.open(copied) as log:
        for frame, image in zip(log.frames("/top/image/compressed"), wanted, strict=True):
            np.testing.assert_array_equal(frame.image, image)


def _cut(path: Path, share: float) -> None:
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])


def test_open_reports_lost_parts_of_a_video(copied):
    video = copied / f"videos/chunk-000/{drawn.CAMERA}/episode_000000.mp4"
    drawn.film(video, drawn.images(7))
    assert "lost: " in texts(copied) and "the video has 7 frames, the table 12 rows" in texts(copied)
    _cut(video, 0.6)
    with logs.open(copied) as log:
        assert len(log["/joint_states"]) == 12
    assert "the video cannot be opened, it may be cut" in texts(copied)
    with pytest.raises(LogError, match="--strict"):
        open_log(copied, strict=True)
    video.unlink()
    assert "there is no such file; is the dataset downloaded completely?" in texts(copied)


def test_open_reads_sound_images_of_a_damaged_video(copied):
    video = copied / f"videos/chunk-000/{drawn.CAMERA}/episode_000000.mp4"
    drawn.film(video, drawn.images(12), "mpeg4", g="1")
    data = bytearray(video.read_bytes())
    begin = data.index(b"mdat") + len(data) // 3
    data[begin : begin + 900] = bytes(900)
    video.write_bytes(data)
    with open_log(copied) as log:
        (camera,) = (topic for topic in log.topics if topic.name == "/top/image")
        messages = sum(len(batch.log_ns) for batch in log.batches((camera.id,)))
        assert messages == camera.messages == 12
    read = recording.read_recording(copied, Settings())
    assert read.cameras.frames is not None
    assert len(list(read.cameras.frames())) == 12


def _edited(folder: Path, **more: object) -> Path:
    info = json.loads((folder / "meta/info.json").read_text())
    (folder / "meta/info.json").write_text(json.dumps(info | more))
    return folder


HOSTILE = {
    "no JSON": (lambda f: (f / "meta/info.json").write_text("{"), "this is not JSON"),
    "no features": (lambda f: _edited(f, features=3), "no LeRobot info.json: features is int"),
    "another version": (lambda f: _edited(f, codebase_version="v1.6"), "codebase_version is 'v1.6'; v2.0, v2.1"),
    "no rate": (lambda f: _edited(f, fps=1e400), "fps is inf"),
    "a path out of it": (lambda f: _edited(f, data_path="../../{episode_index:06d}"), "is not a path within the dataset"),
    "a path too wide": (lambda f: _edited(f, data_path="{episode_index:0999999999d}"), "is not a path within the dataset"),
    "a path with code": (lambda f: _edited(f, data_path="{episode_index.__class__}"), "is not a path within the dataset"),
    "a cut table": (lambda f: _cut(f / "data/chunk-000/episode_000000.parquet", 0.5), "the table cannot be read"),
    "an empty table": (lambda f: (f / "data/chunk-000/episode_000000.parquet").write_bytes(b""), "cannot be read"),
    "no list": (lambda f: (f / "meta/episodes.jsonl").unlink(), "episodes.jsonl: there is no such file"),
    "a broken list": (lambda f: (f / "meta/episodes.jsonl").write_text("[1]\n"), "line 1 is not a JSON object"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_open_refuses_unreadable_datasets_in_one_line(name, copied):
    spoil, text = HOSTILE[name]
    spoil(copied)
    with pytest.raises(InputError) as refused:
        open_log(copied)
    assert text in str(refused.value) and "\n" not in str(refused.value)


def test_open_reports_missing_features_as_lost(copied):
    table = drawn.columns(0, 12)
    del table["action"]
    drawn.table(copied / "data/chunk-000/episode_000000.parquet", table)
    declared = texts(copied)
    assert "lost: " in declared and "action: info.json declares it, the table holds no such numbers" in declared


def test_columns_pad_lists_with_nan(copied):
    rows = [[0.1, 0.2, 0.3]] * 6 + [[0.1, 0.2]] * 5 + [None]
    drawn.table(copied / "data/chunk-000/episode_000000.parquet", drawn.columns(0, 12) | {"observation.state": rows})
    with logs.open(copied) as log:
        position = log["/joint_states"].position
    assert np.isnan(position[6:11, 2]).all() and np.isnan(position[11]).all() and np.isfinite(position[:6]).all()


def test_columns_check_declared_sizes_first(copied):
    from bodylog.logs.limits import Input

    with pytest.raises(LogError, match=r"observation.state: 0.000288 MB .* max_table_mb = 1"):
        open_log(copied, limits=Input(max_table_mb=0.0002))


def test_survey_refuses_large_images(copied):
    from bodylog.logs.limits import Input

    with open_log(copied, limits=Input(max_image_mpx=0.001)) as log:
        assert [topic.name for topic in log.topics if "image" in topic.name] == []
        assert "images of 64 x 64; set [input] max_image_mpx" in log.findings[-1].text


def test_survey_refuses_a_text_file(copied):
    video = copied / f"videos/chunk-000/{drawn.CAMERA}/episode_000000.mp4"
    video.write_text("ffconcat version 1.0\nfile /etc/hostname\n")
    assert "its first bytes are those of no MP4, Matroska or AVI" in texts(copied)


@pytest.mark.parametrize("module", ["pyarrow", "av"])
def test_open_names_a_missing_package(module, old, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UsageError, match=r"type: pip install 'bodylog\[datasets\]'"):
        open_log(Path(f"{old}#1"))


def test_open_reads_a_real_dataset(tmp_path):
    if not REAL.is_dir():
        pytest.skip("the real SO-101 dataset (../shared/real/so101) is not at hand")
    found = facts.describe_log(REAL, Settings())
    assert found["format"] == "lerobot v2.1" and found["unit"] == "rad" and len(found["joints"]) == 12
    counts = {one["topic"]: one["messages"] for one in found["topics"]}
    assert counts == {"/action": 348, "/joint_states": 348, "/cam0/image": 348, "/cam1/image": 348, "/task": 1}
    video = REAL / "videos/chunk-000/observation.images.cam1/episode_000001.mp4"
    with logs.open(REAL, episode=1) as log:
        for frame, image in zip(log.frames("/cam1/image"), drawn.decoded(video), strict=True):
            np.testing.assert_array_equal(frame.image, image)

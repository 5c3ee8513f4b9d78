"""A dataset converted to MCAP and back keeps values, images and times; any log becomes a dataset."""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

import bodylog.logs as logs
from bodylog import info, pipeline
from bodylog.errors import FormatError, LogError, UsageError
from bodylog.logs.datasets import encode, video
from bodylog.logs.formats import open_log
from bodylog.logs.limits import Input
from bodylog.recording.dataset_rows import nearest_indices
from bodylog.settings import Settings
from tests.logs.datasets import drawn

REAL = Path(__file__).parents[3] / "shared" / "real" / "so101"
FORMS = {"lerobot": "lerobot v3.0", "lerobot-2.1": "lerobot v2.1"}


def same(one: Path, other: Path, whole: bool = True) -> None:
    """Assert equal signals and images, at equal times, under equal names; not `whole`: as long as the other log."""
    with logs.open(one) as a, logs.open(other) as b:
        assert {topic.name for topic in a.topics} == {topic.name for topic in b.topics}
        assert not whole or {t.name: t.messages for t in a.topics} == {t.name: t.messages for t in b.topics}
        for topic in a.topics:
            if "image" in topic.name:
                for frame, again in zip(a.frames(topic.name), b.frames(topic.name), strict=whole):
                    assert frame.source_ns == again.source_ns
                    np.testing.assert_array_equal(frame.image, again.image)
                continue
            for field in a[topic.name].fields:
                x, y = a[topic.name][field], b[topic.name][field]
                np.testing.assert_array_equal(x[: None if whole else len(y)], y, f"{topic.name}.{field}")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("source", [drawn.v21, drawn.v30])
def test_convert_to_mcap_and_back_keeps_a_dataset(source, form, tmp_path):
    folder = source(tmp_path / "set", [12, 9])
    for number in (0, 1):
        log, back = Path(f"{folder}#{number}"), tmp_path / f"back{number}"
        pipeline.ingest(log, tmp_path / "run.mcap", Settings())
        done = pipeline.convert([tmp_path / "run.mcap"], back, Settings(), form)
        assert "every image as in the log" in " ".join(one.text for one in done.findings)
        same(log, back)
        with open_log(back) as opened:
            assert opened.format == FORMS[form]
    info = json.loads((back / "meta/info.json").read_text())
    assert info["fps"] == drawn.FPS and info["robot_type"] == "drawn" and info["total_frames"] == 9
    kinds = {name: one["dtype"] for name, one in info["features"].items()}
    assert kinds["observation.state"] == kinds["action"] == "float32" and kinds["next.done"] == "bool"


def test_convert_is_deterministic(tmp_path):
    log = drawn.v30(tmp_path / "set", [12])
    for name in ("a", "b"):
        pipeline.convert([log], tmp_path / name, Settings(), "lerobot")
    files = [path.relative_to(tmp_path / "a") for path in sorted((tmp_path / "a").rglob("*")) if path.is_file()]
    assert len(files) == 6
    assert all((tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes() for file in files)


@pytest.mark.parametrize("form", FORMS)
def test_convert_writes_one_episode_per_log(form, tmp_path):
    folder = drawn.v21(tmp_path / "set", [12, 9, 15])
    several = [Path(f"{folder}#{number}") for number in (2, 0)]
    pipeline.convert(several, tmp_path / "new", Settings(), form, task="fold it")
    same_but_task = [Path(f"{tmp_path}/new#{number}") for number in (0, 1)]
    for log, new in zip(several, same_but_task, strict=True):
        with logs.open(log) as a, logs.open(new) as b:
            np.testing.assert_array_equal(a["/joint_states"].position, b["/joint_states"].position)
            assert [one.value.data for one in b.messages(["/task"])] == ["fold it"]
            frames = zip(a.frames("/top/image"), b.frames("/top/image"), strict=True)
            assert all(np.array_equal(x.image, y.image) for x, y in frames)


def test_stats_match_the_values(tmp_path):
    pipeline.convert([drawn.v30(tmp_path / "set", [12, 9])], tmp_path / "new", Settings(), "lerobot")
    stats = json.loads((tmp_path / "new/meta/stats.json").read_text())
    q = drawn.angles(12).astype(float)
    for name, of in (("min", np.min), ("max", np.max), ("mean", np.mean), ("std", np.std)):
        np.testing.assert_allclose(stats["observation.state"][name], of(q, axis=0), rtol=1e-6)
    with logs.open(tmp_path / "new") as log:
        pixels = np.stack([frame.image[::8, ::8, ::-1] for frame in log.frames("/top/image")]).reshape(-1, 3) / 255
    np.testing.assert_allclose(np.ravel(stats[drawn.CAMERA]["mean"]), pixels.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(np.ravel(stats[drawn.CAMERA]["std"]), pixels.std(axis=0), rtol=1e-9)


def test_convert_writes_v3_tables_as_lerobot_expects(tmp_path):
    pandas = pytest.importorskip("pandas")
    pipeline.convert([drawn.v21(tmp_path / "set", [12])], tmp_path / "new", Settings(), "lerobot")
    tasks = pandas.read_parquet(tmp_path / "new/meta/tasks.parquet")
    assert tasks.loc["push"].task_index == 0 and tasks.index.name == "task"
    episode = pandas.read_parquet(tmp_path / "new/meta/episodes/chunk-000/file-000.parquet").iloc[0]
    assert episode["dataset_to_index"] == episode["length"] == 12
    assert episode[f"videos/{drawn.CAMERA}/to_timestamp"] == pytest.approx(12 / drawn.FPS)
    rows = pandas.read_parquet(tmp_path / "new/data/chunk-000/file-000.parquet")
    np.testing.assert_allclose(rows["timestamp"], np.arange(12) / drawn.FPS, atol=1e-6)


@pytest.mark.parametrize(("how", "most"), [("h264", 8.0), ("av1", 12.0)])
def test_encode_measures_its_error(how, most, tmp_path):
    log = drawn.v21(tmp_path / "set", [12])
    done = pipeline.convert([log], tmp_path / "new", Settings(), "lerobot", how)
    (text,) = (one.text for one in done.findings if "grey levels" in one.text)
    reported = float(text.split("differ by ")[1].split()[0])
    with logs.open(log) as a, logs.open(tmp_path / "new") as b:
        pairs = list(zip(a.frames("/top/image"), b.frames("/top/image"), strict=True))
    squares = [np.mean((x.image.astype(float) - y.image) ** 2) for x, y in pairs]
    assert reported == pytest.approx(np.sqrt(np.mean(squares)), rel=0.01) and 0 < reported < most
    assert all(x.source_ns == y.source_ns for x, y in pairs)


@pytest.mark.skipif(sys.platform != "linux" or os.getuid(), reason="an encoder is real-time as root alone")
def test_an_encoder_leaves_no_thread_real_time(tmp_path):
    policies = set()

    def images():
        for image in drawn.images(12):
            policies.update(os.sched_getscheduler(int(name)) for name in os.listdir("/proc/self/task"))
            yield image

    codec = encode.find_codec("av1")
    encode.encode_video(tmp_path / "a.mp4", codec, images, np.arange(12) / drawn.FPS, drawn.SIZE)
    assert policies == {os.SCHED_OTHER}


def _recorded(path: Path, rows: int = 30) -> Path:
    """A log with joints at 100 Hz and images at irregular times, with stamps of their own."""
    start = 1_700_000_000_123_456_789
    fast = start + np.arange(3 * rows) * 10_000_000
    slow = start + 7_000_001 + np.arange(rows) * 30_000_000 + (np.arange(rows) % 3) * 2_000_000
    q = np.sin(np.arange(3 * rows)[:, None] * [0.03, 0.05]) / 3
    data = [image.tobytes() for image in drawn.images(rows)]
    with logs.Writer(path) as out:
        joints = {"header.stamp": fast, "name": ["pan", "lift"], "position": q}
        out.write("/joint_states", "sensor_msgs/msg/JointState", fast, joints)
        out.write("/arm/command", "sensor_msgs/msg/JointState", fast, joints | {"position": q + 0.1})
        size = {"height": 64, "width": 64, "encoding": "bgr8", "step": 192}
        out.write("/cam/image", "sensor_msgs/msg/Image", slow, {"header.stamp": slow, **size, "data": data})
        out.write("/load", "my_msgs/msg/Load", fast, {"newton": q[:, 0]}, definition="float64 newton")
    return path


def test_convert_keeps_a_logs_own_times(tmp_path):
    log = _recorded(tmp_path / "run.mcap")
    ticks = list[int]()
    done = pipeline.convert([log], tmp_path / "new", Settings(), "lerobot", progress=ticks.append)
    assert sum(ticks) == info.dataset_images(log, Settings()) == 30
    reported = " ".join(one.text for one in done.findings)
    assert (
        "topics that the dataset leaves out: /load" in reported and "the nearest reading of others is taken" in reported
    )
    with logs.open(log) as a, logs.open(tmp_path / "new") as b:
        old, new = a["/joint_states"], b["/joint_states"]
        frames = list(zip(a.frames("/cam/image"), b.frames("/cam/image"), strict=True))
        assert all(np.array_equal(x.image, y.image) and x.source_ns == y.source_ns for x, y in frames)
        which = np.searchsorted(old.header.stamp, new.header.stamp)
        np.testing.assert_array_equal(old.header.stamp[which], new.header.stamp)
        np.testing.assert_array_equal(old.position[which], new.position)
        np.testing.assert_array_equal(a["/arm/command"].position[which], b["/action"].position)
        assert np.abs(new.header.stamp - [x.source_ns for x, _ in frames]).max() <= 5_000_000
        assert not [one.text for one in b.findings if "drift apart" in one.text]
    assert "timestamp is frame_index / 31.25, as LeRobot needs it; the rows' times differ by up to" in reported
    rows = pytest.importorskip("pyarrow.parquet").read_table(tmp_path / "new/data/chunk-000/file-000.parquet")
    np.testing.assert_allclose(rows["timestamp"], np.arange(30) / 31.25, atol=1e-6)
    (film,) = (tmp_path / "new/videos").rglob("*.mp4")
    np.testing.assert_allclose(video.survey_video(film, Input()).t, np.arange(30) / 31.25, atol=1e-6)
    features = json.loads((tmp_path / "new/meta/info.json").read_text())["features"]
    assert features["observation.state"]["dtype"] == "float64"  # in float32 they would not be the same
    assert features["observation.state"]["unit"] == "rad"


def test_convert_writes_part_of_a_log(tmp_path):
    log = _recorded(tmp_path / "run.mcap")
    pipeline.convert([log], tmp_path / "new", Settings(), "lerobot", start=0.3, end=0.6)
    with logs.open(log) as a, logs.open(tmp_path / "new") as b:
        start = a["/joint_states"].header.stamp[0]
        taken = b["/cam/image"].header.stamp - start
        assert taken.min() >= 300_000_000 and taken.max() <= 600_000_000 and len(taken) == 10
    with pytest.raises(LogError, match="no rows in the requested time"):
        pipeline.convert([log], tmp_path / "none", Settings(), "lerobot", start=50.0)


def test_nearest_matches_argmin():
    rng = np.random.default_rng(1)
    of, at = np.unique(rng.integers(0, 1000, 40)), np.unique(rng.integers(-50, 1100, 90))
    wanted = [int(np.abs(of - one).argmin()) for one in at]  # argmin takes the earlier of two
    np.testing.assert_array_equal(nearest_indices(of, at), wanted)
    np.testing.assert_array_equal(nearest_indices(of[:1], at), np.zeros(len(at)))


def test_convert_refuses_bad_input_and_leaves_nothing(tmp_path):
    log, other = drawn.v21(tmp_path / "set", [12]), drawn.robomimic(tmp_path / "demos.hdf5", (0,))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    convert, settings = pipeline.convert, Settings()
    with pytest.raises(UsageError, match="already exists; give the name of a new folder"):
        convert([log], tmp_path / "full", settings, "lerobot")
    with pytest.raises(UsageError, match="--codec x264: possible are lossless, h264, av1"):
        convert([log], tmp_path / "new", settings, "lerobot", "x264")
    with pytest.raises(UsageError, match=r"--to rlds: possible are mcap, lerobot, lerobot-2\.1"):
        convert([log], tmp_path / "new", settings, "rlds")
    with pytest.raises(FormatError, match="its streams are not those of the first log"):
        convert([log, other], tmp_path / "new", settings, "lerobot")
    with pytest.raises(UsageError, match=r"2 logs: an MCAP is made of one"):
        convert([log, other], tmp_path / "new.mcap", settings)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["demos.hdf5", "full", "set"]


def test_encode_needs_lossless_for_odd_sizes(tmp_path):
    log = tmp_path / "odd.mcap"
    stamp = 10**9 + np.arange(5) * 50_000_000
    size = {"height": 33, "width": 47, "encoding": "bgr8", "step": 141}
    data = [np.full((33, 47, 3), 10 * k, np.uint8).tobytes() for k in range(5)]
    with logs.Writer(log) as out:
        out.write("/cam/image", "sensor_msgs/msg/Image", stamp, {"header.stamp": stamp, **size, "data": data})
    with pytest.raises(UsageError, match="needs even sides; type: --codec lossless"):
        pipeline.convert([log], tmp_path / "new", Settings(), "lerobot", "h264")
    pipeline.convert([log], tmp_path / "new", Settings(), "lerobot")
    with logs.open(tmp_path / "new") as back:
        assert [int(frame.image[0, 0, 0]) for frame in back.frames("/cam/image")] == [0, 10, 20, 30, 40]


def test_convert_counts_unreadable_images(tmp_path):
    import cv2

    stamp = 10**9 + np.arange(6) * 50_000_000
    data = [cv2.imencode(".png", image)[1].tobytes() for image in drawn.images(6)]
    data[2] = data[2][:40]
    with logs.Writer(tmp_path / "run.mcap") as out:
        fields = {"header.stamp": stamp, "format": "png", "data": data}
        out.write("/cam/image/compressed", "sensor_msgs/msg/CompressedImage", stamp, fields)
    done = pipeline.convert([tmp_path / "run.mcap"], tmp_path / "new", Settings(), "lerobot")
    assert [one.severity for one in done.findings if "1 of 6 images cannot be read" in one.text] == ["lost"]
    with logs.open(tmp_path / "new") as back:
        frames = [frame.image for frame in back.frames("/cam/image")]
    np.testing.assert_array_equal(frames[2], frames[1])


def test_convert_keeps_degrees(tmp_path):
    folder = drawn.v21(tmp_path / "set", [12])
    info = json.loads((folder / "meta/info.json").read_text())
    info["features"]["observation.state"]["unit"] = "degrees"
    (folder / "meta/info.json").write_text(json.dumps(info))
    pipeline.ingest(folder, tmp_path / "run.mcap", Settings())
    pipeline.convert([tmp_path / "run.mcap"], tmp_path / "new", Settings(), "lerobot")
    with logs.open(tmp_path / "run.mcap") as log:
        np.testing.assert_allclose(log["/joint_states"].position, np.deg2rad(drawn.angles(12).astype(float)))
    with logs.open(tmp_path / "new") as log:
        np.testing.assert_array_equal(log["/joint_states"].position, drawn.angles(12))


@pytest.mark.soak
def test_convert_to_mcap_and_back_keeps_a_real_dataset(tmp_path):
    if not REAL.is_dir():
        pytest.skip("the real SO-101 dataset (../shared/real/so101) is not at hand")
    pipeline.ingest(Path(f"{REAL}#1"), tmp_path / "run.mcap", Settings(), end=3.0)
    pipeline.convert([tmp_path / "run.mcap"], tmp_path / "new", Settings(), "lerobot")
    with open_log(tmp_path / "new") as opened:
        assert {topic.messages for topic in opened.topics} == {1, 56}  # the first 3 s
    same(Path(f"{REAL}#1"), tmp_path / "new", whole=False)

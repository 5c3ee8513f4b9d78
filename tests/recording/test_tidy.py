import base64
import json

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from bodylog.errors import LogError, UsageError
from bodylog.logs.limits import Input
from bodylog.logs.tables import pose_log
from bodylog.logs.tables.pose_log import PoseLog
from bodylog.recording.recording import read_recording
from bodylog.recording.tidy import cut_to_window, signals_by_role, write_tidy_log
from bodylog.settings import Settings, TimeSettings, TopicSettings
from tests.logs.datasets import drawn
from tests.logs.written import START, by_pybag, by_rosbags, source

LOGS = ["reach.mcap", "reach.bag", "reach_rosbag2"]
TIDY = {"/joint_states", "/truth/joint_states", "/skin", "/camera/image/compressed"}


@pytest.fixture(params=LOGS)
def log(arm, request):
    return arm / request.param


def pictures(recording):
    return [(frame.t, frame.image) for frame in recording.cameras.frames()]


def test_ingest_keeps_signals_under_tidy_names(tmp_path, log):
    write_tidy_log(log, tmp_path / "out.mcap", Settings())
    before, after = read_recording(log, Settings()), read_recording(tmp_path / "out.mcap", Settings())
    with AnyReader([tmp_path / "out.mcap"]) as reader:
        assert set(reader.topics) == TIDY
    assert after.start_ns == before.start_ns
    for role, series in signals_by_role(before).items():
        again = signals_by_role(after)[role]
        assert again.names == series.names and np.array_equal(again.t, series.t)
        tolerance = 1e-7 if role == "skin" else 0.0
        assert np.allclose(again.values, series.values, rtol=tolerance, atol=0, equal_nan=True)
    frames = pictures(after)
    assert [t for t, _ in frames] == [t for t, _ in pictures(before)]
    assert all(np.array_equal(a, b) for (_, a), (_, b) in zip(frames[::20], pictures(before)[::20], strict=True))


def test_ingest_logs_at_the_chosen_times(tmp_path, log):
    write_tidy_log(log, tmp_path / "out.mcap", Settings())
    recording = read_recording(log, Settings())
    with (tmp_path / "out.mcap").open("rb") as stream:
        times = {}
        for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            times.setdefault(channel.topic, []).append(message.log_time)
    stamps = recording.start_ns + np.rint(recording.signals.joints.t * 1e9).astype(np.int64)
    assert np.array_equal(times["/joint_states"], stamps)
    camera = [recording.start_ns + round(frame.t * 1e9) for frame in recording.cameras.frames()]
    assert times["/camera/image/compressed"] == camera


def test_ingest_can_use_the_log_clock(tmp_path, arm):
    by_log = Settings(time=TimeSettings(joints="log", camera="log", truth="log"))
    write_tidy_log(arm / "reach.mcap", tmp_path / "log.mcap", by_log)
    write_tidy_log(arm / "reach.mcap", tmp_path / "header.mcap", Settings())
    late = by_rosbags(tmp_path / "log.mcap"), by_rosbags(tmp_path / "header.mcap")
    joints = [[t for topic, t, _ in messages if topic == "/joint_states"] for messages in late]
    assert np.array_equal(np.subtract(*joints), np.full(len(joints[0]), 4_000_000))


def test_ingest_output_is_read_by_every_reader(tmp_path, log):
    write_tidy_log(log, tmp_path / "out.mcap", Settings())
    assert by_rosbags(tmp_path / "out.mcap") == by_pybag(tmp_path / "out.mcap")


def test_ingest_is_deterministic(tmp_path, log):
    for name in ("a", "b"):
        write_tidy_log(log, tmp_path / name, Settings())
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_ingest_keeps_only_the_window(tmp_path, log):
    write_tidy_log(log, tmp_path / "out.mcap", Settings(), start=2.0, end=3.5)
    whole, part = read_recording(log, Settings()), read_recording(tmp_path / "out.mcap", Settings())
    for role, series in signals_by_role(whole).items():
        kept = cut_to_window(series, whole.start_ns, (2.0, 3.5))
        assert 0 < len(kept.t) < len(series.t)
        assert np.array_equal(signals_by_role(part)[role].values.astype(np.float32), kept.values.astype(np.float32))
    assert len(pictures(part)) == sum(2.0 <= t <= 3.5 for t, _ in pictures(whole))


def test_ingest_refuses_an_empty_window(tmp_path, log):
    with pytest.raises(LogError, match=r"no joints, skin, truth or images from 900.0 s to the end"):
        write_tidy_log(log, tmp_path / "out.mcap", Settings(), start=900.0)
    assert not list(tmp_path.iterdir())


def test_ingest_refuses_a_log_without_roles(tmp_path):
    with pytest.raises(LogError, match="no joints, skin, truth or images in it"):
        write_tidy_log(source(tmp_path / "in.mcap"), tmp_path / "out.mcap", Settings())


def test_ingest_refuses_the_input_as_output(tmp_path, arm):
    link = tmp_path / "out.mcap"
    link.symlink_to(arm / "reach.mcap")
    with pytest.raises(UsageError, match="is also an input"):
        write_tidy_log(arm / "reach.mcap", link, Settings())


def test_ingest_writes_a_video_as_jpegs(tmp_path, arm):
    video = cv2.VideoWriter(str(tmp_path / "side.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (64, 48))
    for level in range(0, 250, 25):
        video.write(np.full((48, 64, 3), level, np.uint8))
    video.release()
    settings = Settings(topics=TopicSettings(camera=str(tmp_path / "side.avi"), start=START / 1e9))
    first_s = START / 1e9 - read_recording(arm / "reach.mcap", Settings()).start_ns / 1e9
    write_tidy_log(arm / "reach.mcap", tmp_path / "out.mcap", settings)
    frames = pictures(read_recording(tmp_path / "out.mcap", Settings()))
    assert np.allclose([t for t, _ in frames], first_s + np.arange(10) / 10, atol=1e-6)
    assert np.allclose([image.mean() for _, image in frames], range(0, 250, 25), atol=3)


TIME = {"type": "object", "title": "time", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}


def json_log(path, kind, message, odd=None):
    """Five JSON images, a second apart; `odd` overrides fields of the third."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("", "someone else's recorder")
        text = json.dumps({"type": "object", "properties": {"timestamp": TIME, "data": {"type": "string"}}})
        schema = writer.register_schema(kind, "jsonschema", text.encode())
        channel = writer.register_channel("/cam", "json", schema)
        for i in range(5):
            fields = {"timestamp": {"sec": 1_700_000_000 + i, "nsec": 5}, "frame_id": "eye", **message}
            fields |= (odd or {}) if i == 2 else {}
            writer.add_message(channel, START + i, json.dumps(fields).encode(), START + i)
        writer.finish()
    return path


def ingested(tmp_path, log):
    write_tidy_log(log, tmp_path / "out.mcap", Settings())
    with AnyReader([tmp_path / "out.mcap"]) as reader:
        return [(c.topic, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages()]


def test_ingest_converts_compressed_json_images(tmp_path):
    jpeg = cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes()
    message = {"format": "jpeg", "data": base64.b64encode(jpeg).decode()}
    found = ingested(tmp_path, json_log(tmp_path / "in.mcap", "foxglove.CompressedImage", message))
    assert [m.header.stamp.sec for _, m in found] == [1_700_000_000 + i for i in range(5)]
    kept = {(topic, m.header.frame_id, m.format, m.data.tobytes()) for topic, m in found}
    assert kept == {("/camera/image/compressed", "eye", "jpeg", jpeg)}


def test_ingest_counts_a_malformed_image(tmp_path):
    jpeg = cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes()
    message = {"format": "jpeg", "data": base64.b64encode(jpeg).decode()}
    log = json_log(tmp_path / "in.mcap", "foxglove.CompressedImage", message, {"data": "not base64!"})
    lost = [f.text for f in write_tidy_log(log, tmp_path / "out.mcap", Settings()) if f.severity == "lost"]
    assert len(lost) == 1 and f"{log}: /cam: 1 images cannot be read and are left out, the first for this: " in lost[0]
    with AnyReader([tmp_path / "out.mcap"]) as reader:
        assert reader.message_count == 4


def test_ingest_converts_raw_json_images(tmp_path):
    pixels = bytes(range(24))
    message = {"width": 4, "height": 2, "encoding": "rgb8", "step": 12, "data": base64.b64encode(pixels).decode()}
    found = ingested(tmp_path, json_log(tmp_path / "in.mcap", "foxglove.RawImage", message))
    kept = {(topic, m.width, m.height, m.encoding, m.step, m.is_bigendian, m.data.tobytes()) for topic, m in found}
    assert kept == {("/camera/image", 4, 2, "rgb8", 12, 0, pixels)} and len(found) == 5


def test_ingest_reads_a_foreign_protobuf_log(tmp_path, arm):
    log = arm.parent / "gagalo123__mcap-explorer" / "examples" / "demo.mcap"
    found = ingested(tmp_path, log)
    assert len(found) == 30
    before = pictures(read_recording(log, Settings()))
    after = pictures(read_recording(tmp_path / "out.mcap", Settings()))
    assert all(np.array_equal(a, b) for (_, a), (_, b) in zip(before, after, strict=True))


def test_ingest_reports_messages_before_time_zero(tmp_path):
    """Joints in simulation time from 1 s at half speed: images begin earlier."""
    from tests.logs import writing
    from tests.logs.writing import camera, compressed, joint_state, joints

    t0, picture = writing.T0, np.zeros((8, 8, 3), np.uint8)
    rows = [(t0 + k * 10**8, joint_state(10**9 + k * 5 * 10**7, ("a",), (0.1 * k,))) for k in range(50)]
    seen = [(t0 + k * 10**8, compressed(t0 + k * 10**8, picture)) for k in range(50)]
    log = writing.write(tmp_path / "a.mcap", [joints("/j", rows), camera("/cam", seen)])
    findings = write_tidy_log(log, tmp_path / "out.mcap", Settings())
    (fields,) = [f.text for f in findings if "left out" in f.text]
    left = int(fields.removeprefix(f"{log}: ").split()[0])
    after = read_recording(tmp_path / "out.mcap", Settings())
    assert 0 < left < 50 and len(list(after.cameras.frames())) == 50 - left and len(after.signals.joints.t) == 50


def test_ingest_refuses_a_damaged_log_if_strict(tmp_path, arm):
    log = tmp_path / "cut.mcap"
    log.write_bytes((arm / "reach.mcap").read_bytes()[:-200_000])
    with pytest.raises(LogError, match="without --strict"):
        write_tidy_log(log, tmp_path / "out.mcap", Settings(input=Input(strict=True)))
    assert list(tmp_path.iterdir()) == [log]


def test_ingest_tells_of_a_datasets_images_that_cannot_be_read(tmp_path):
    path = drawn.aloha(tmp_path / "episode_0.hdf5", packed=True)
    with drawn.h5py.File(path, "r+") as file:
        file["observations/images/top"][3:5] = 0
    findings = write_tidy_log(path, tmp_path / "out.mcap", Settings())
    (lost,) = (one.text for one in findings if one.severity == "lost")
    assert "2 of 20 images cannot be read; they stand in it without bytes" in lost


def test_ingest_reads_a_table_once(tmp_path, monkeypatch):
    opened = []

    class CountedLog(PoseLog):
        def __init__(self, path, *others):
            opened.append(path)
            super().__init__(path, *others)

    monkeypatch.setattr(pose_log, "PoseLog", CountedLog)
    path = tmp_path / "poses.csv"
    path.write_text("elbow\n" + "0.1\n" * 10)
    write_tidy_log(path, tmp_path / "out.mcap", Settings())
    assert opened == [path]

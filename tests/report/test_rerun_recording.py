"""A log in Rerun, as Rerun's own program and reader find it."""

import subprocess
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from bodylog import views
from bodylog.errors import LogError, UsageError
from bodylog.report.viewers import rerun_process, rerun_recording
from tests.report.pages import HOSTILE, hostile_parts

from ..logs.writing import T0, Stream, cdr, define, header, joint_state, joints, write
from .records import estimate, features

there = pytest.mark.skipif(find_spec("rerun_cli") is None, reason="needs rerun-sdk (pip install 'bodylog[view]')")


@pytest.fixture(scope="module")
def annotated(run_cli, robot):
    """The small robot's reaching with its estimate."""
    out = robot / "viewed.mcap"
    assert run_cli("estimate", robot / "reach.mcap", "--body", robot / "body.npz", "-o", out) == 0
    return out


@pytest.fixture(scope="module")
def seen(run_cli, annotated):
    """The same as a recording."""
    out = annotated.with_suffix(".rrd")
    assert run_cli("view", annotated, "-o", out) == 0
    return out


def rerun(home, *arguments):
    """What Rerun's program says, in a home of its own where it counts nothing."""
    rerun_process.disable_analytics(home)
    command = [*rerun_process.PROGRAM, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, env={"HOME": str(home)})
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def values(recording, entity, component):
    """Log times (n,) ns and the component's lists of one entity over the messages' time."""
    from rerun.chunk import RrdReader

    ns, found = [], []
    for chunk in RrdReader(recording).stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path == entity and component in batch.schema.names and not chunk.is_static:
            ns.append(batch.column("message_log_time").cast("int64").to_numpy())
            found += batch.column(component).to_pylist()
    return np.concatenate(ns), found


@there
def test_rerun_verifies_it_and_finds_estimate_pictures_and_annotations(seen, tmp_path):
    assert "1 file verified without error" in rerun(tmp_path, "rrd", "verify", seen)
    printed = rerun(tmp_path, "rrd", "print", "-v", seen)
    joints = ("elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint")
    for entity, component in (
        ("/camera/image/compressed", "EncodedImage:blob"),
        (r"/camera/image/compressed/effector\ seen", "Points2D:positions"),
        (r"/camera/image/compressed/effector\ predicted", "Points2D:positions"),
        (r"/camera/image/compressed/effector\ predicted\,\ 2\ sigma", "LineStrips2D:strips"),
        (r"/camera/image/compressed/effector\ seen", "CoordinateFrame:frame"),
        ("/bodylog/annotations", "foxglove_msgs.msg.ImageAnnotations:message"),
        ("/bodylog/joint_states/position", "Scalars:scalars"),
        *((f"/bodylog/belief/{joint}", "Scalars:scalars") for joint in joints),
        *((f"/bodylog/belief/{joint}/truth", "Scalars:scalars") for joint in joints),
        ("/bodylog/errors/effector", "Scalars:scalars"),
        ("/bodylog/energy", "Scalars:scalars"),
    ):
        assert f"{entity}@{component}" in printed.replace("\n", " "), (entity, component)


@there
def test_points_lie_where_and_when_the_log_says(seen, annotated):
    from bodylog.annotating import read_back as log
    from bodylog.recording import recording
    from bodylog.settings import Settings

    estimate, track = log.read_estimate(annotated), recording.read_recording(annotated, Settings()).signals.features.effector
    for name, series in (("seen", track), ("predicted", estimate.predicted["effector"])):
        ns, points = values(seen, rf"/camera/image/compressed/effector\ {name}", "Points2D:positions")
        order = np.argsort(ns, kind="stable")
        assert ns[order].tolist() == series.source_ns.tolist()
        for row, place in zip(order.tolist(), series.values, strict=True):
            drawn = points[row] or []
            assert len(drawn) == int(np.isfinite(place).all()), "a point where nothing was seen, or none where it was"
            assert not drawn or np.allclose(drawn[0], place + 0.5, atol=1e-3)
    unseen = ~np.isfinite(track.values).all(axis=1)
    assert unseen.any() and not unseen.all()


@there
def test_overlay_lies_in_the_image_plane(seen):
    from rerun.chunk import RrdReader

    frames = {}
    for chunk in RrdReader(seen).stream():
        batch = chunk.to_record_batch()
        if "CoordinateFrame:frame" in batch.schema.names:
            frames.setdefault(chunk.entity_path, batch.column("CoordinateFrame:frame").to_pylist()[0][0])
    picture = frames["/camera/image/compressed"]
    assert frames[r"/camera/image/compressed/effector\ seen"] == frames[r"/camera/image/compressed/effector\ predicted"]
    assert picture == frames[r"/camera/image/compressed/effector\ seen"] == "camera_optical_frame_image_plane"


@there
def test_view_shows_a_log_without_an_estimate(run_cli, robot, tmp_path, capsys):
    capsys.readouterr()
    assert run_cli("view", robot / "reach.mcap", "-o", tmp_path / "r.rrd") == 0
    printed = rerun(tmp_path, "rrd", "stats", tmp_path / "r.rrd")
    assert "/camera/image/compressed" in printed and "/joint_states/position" in printed and "/bodylog" not in printed


@there
def test_view_converts_a_bag_first(run_cli, arm, tmp_path):
    assert run_cli("view", arm / "reach.bag", "-o", tmp_path / "b.rrd") == 0
    printed = rerun(tmp_path, "rrd", "stats", tmp_path / "b.rrd")
    assert "/joint_states/position" in printed and "image" in printed


@there
def test_view_decompresses_a_packed_log(run_cli, robot, tmp_path):
    import zstandard

    (tmp_path / "x.mcap.zst").write_bytes(zstandard.compress((robot / "reach.mcap").read_bytes()))
    assert run_cli("view", tmp_path / "x.mcap.zst", "-o", tmp_path / "x.rrd") == 0
    assert "/joint_states/position" in rerun(tmp_path, "rrd", "stats", tmp_path / "x.rrd")


def test_frame_id_of_protobuf_images_stands_without_a_header():
    log = Path(__file__).parents[2].parent / "shared" / "logs" / "gagalo123__mcap-explorer" / "examples" / "demo.mcap"
    if not log.exists():
        pytest.skip("needs recorded logs beside the project")
    assert views._frame_id(log, "/camera/front/image") == "cam_front"


@there
def test_frame_id_of_a_topic_with_two_schemas_is_the_first_ones(tmp_path):
    kind, image = "sensor_msgs/msg/CompressedImage", dict(format="jpeg", data=np.zeros(4, np.uint8))
    messages = [(T0 + k, cdr(kind, header=header(T0 + k, "cam"), **image)) for k in range(2)]
    streams = [Stream("/cam", kind, define(kind) + more, messages) for more in (b"", b"# another")]
    assert views._frame_id(write(tmp_path / "two.mcap", streams), "/cam") == "cam"


@there
def test_view_shows_the_sound_part_of_a_truncated_log(run_cli, annotated, tmp_path):
    whole = annotated.read_bytes()
    for bytes_left, code in ((len(whole) // 2, 3), (len(whole) - 10, 0)):
        (tmp_path / "cut.mcap").write_bytes(whole[:bytes_left])
        assert run_cli("view", tmp_path / "cut.mcap", "-o", tmp_path / "c.rrd") == code
        assert len(values(tmp_path / "c.rrd", "/camera/image/compressed", "EncodedImage:blob")[0]) > 10


def raw(encoding):
    """Three grey pictures of 2 by 2 pixels on a topic named like their encoding."""
    kind, channels = "sensor_msgs/msg/Image", 3 if encoding == "rgb8" else 2
    size = {"height": 2, "width": 2, "step": 2 * channels, "data": np.full(4 * channels, 128, np.uint8)}
    payload = cdr(kind, header=header(T0), encoding=encoding, is_bigendian=0, **size)
    return Stream(f"/{encoding}", kind, define(kind), [(T0 + i, payload) for i in range(3)])


@there
def test_pictures_that_rerun_cannot_read_are_converted_or_left_out_by_name(run_cli, tmp_path, capsys):
    log, out, config = tmp_path / "raw\udcff.mcap", tmp_path / "raw\udcff.rrd", tmp_path / "robot.toml"
    write(log, [raw(encoding) for encoding in ("uyvy", "rgb8", "weird")])
    config.write_text('[topics]\ncamera = "/uyvy"\n')
    capsys.readouterr()
    assert run_cli("view", log, "-o", out, "--config", config) == 0
    out.rename(tmp_path / "raw.rrd")
    printed = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning")]
    named = f"{tmp_path}/raw\\udcff.mcap"
    assert printed == [f"warning: {named}: /weird: left out, Rerun cannot show it: got weird"]
    out = tmp_path / "raw.rrd"
    assert len(values(out, "/rgb8", "Image:buffer")[0]) == 3
    ns, pictures = values(out, "/uyvy", "EncodedImage:blob")
    assert ns.tolist() == [T0, T0 + 1, T0 + 2] and bytes(pictures[0][0]).startswith(b"\xff\xd8\xff")


@there
def test_view_falls_back_to_topics_with_roles(run_cli, tmp_path, capsys):
    log, out = tmp_path / "bad.mcap", tmp_path / "bad.rrd"
    broken = Stream("/bad", "broken_msgs/msg/Garbage", b"!!", [(T0, b"\0\1\0\0")])
    rows = [(T0 + i, joint_state(T0 + i, ("a",), (0.1 * i,))) for i in range(5)]
    write(log, [broken, joints("/joints", rows)])
    capsys.readouterr()
    assert run_cli("view", log, "-o", out) == 0
    (printed,) = [line for line in capsys.readouterr().err.splitlines() if "Rerun" in line]
    assert printed.startswith(f"warning: {log}: Rerun cannot read it (Failed to load MCAP file: Invalid schema broken")
    assert printed.endswith("its joints, skin and images alone are shown")
    assert len(values(out, "/joint_states/position", "Scalars:scalars")[0]) == 5
    write(log, [broken])
    assert run_cli("view", log, "-o", out) == 65
    assert f"bodylog: {log}: Rerun cannot read it (Failed to load" in capsys.readouterr().err


@there
@pytest.mark.parametrize("cameras", [
    {}, {"": rerun_recording.RerunCamera(f"/{HOSTILE}/image", "")}, {"": rerun_recording.RerunCamera("/cam", HOSTILE)}
])  # fmt: skip
def test_names_are_names_whatever_signs_they_hold(tmp_path, cameras):
    log = hostile_parts()
    found = log["features"]
    truth = log["recording"].signals.truth
    rerun_recording.write_companion(tmp_path / "h.rrd", HOSTILE, (), cameras, found, log["estimate"], truth)
    assert "1 file verified without error" in rerun(tmp_path, "rrd", "verify", tmp_path / "h.rrd")
    printed = rerun(tmp_path, "rrd", "print", tmp_path / "h.rrd")
    assert printed.count("/bodylog/belief/") >= 6 and "/bodylog/events" in printed
    assert ("/cam/" in printed) == any(camera.topic == "/cam" for camera in cameras.values())


@there
def test_events_are_in_order_with_their_synchrony():
    given = rerun_recording.list_events(features(), estimate())
    assert [ns for ns, *_ in given] == sorted(ns for ns, *_ in given) and len(given) == 6
    assert given[0][2] == "touch of cells 11, 12, 13, seen +0.050 s later, synchrony 0.93"
    assert [text for _, level, text in given if level == "WARN"] == ["encoders shoulder_pan_joint: drifting, 0.3 rad"]
    assert rerun_recording.list_events(None, None) == []


@there
def test_rerun_failure_is_one_line_and_leaves_nothing(tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"no log at all" * 100)
    with pytest.raises(LogError, match=r"a\.mcap: Rerun cannot read it \(.+\); type: bodylog doctor") as refused:
        rerun_process.merge_recording(tmp_path / "a.mcap", tmp_path / "a.rrd", "a", lambda *_: None, lambda _: None)
    assert "\n" not in str(refused.value) and sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap"]


@there
def test_view_without_a_screen_gives_the_command_to_type(annotated, run_cli, monkeypatch, capsys, tmp_path):
    rerun_process.disable_analytics(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    capsys.readouterr()
    assert run_cli("view", annotated) == 2
    err = capsys.readouterr().err
    assert "could not open a window (" in err and "type: bodylog view LOG -o out.rrd" in err and err.count("\n") == 1
    assert ".rs:" not in err and "DISPLAY" in err


def test_missing_rerun_gives_the_command_to_type(monkeypatch):
    monkeypatch.setattr(rerun_process, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=r"pip install 'bodylog\[view\]'"):
        rerun_process.require_rerun()

"""`doctor` measures the delay of a log's images, with and without a body, and accuses no sound log."""

import json
from pathlib import Path

import numpy as np
import pytest

import bodylog.logs as logs
from bodylog import pipeline
from bodylog.delays import findings as delay_findings
from bodylog.settings import Settings, TimeSettings
from tests.changed_recordings import change_recording
from tests.seeds import first_of

ARM = Path(__file__).parents[2] / "fixtures" / "arm"
IMAGES = "/camera/color/image_raw/compressed"
JOINT_STATE, COMPRESSED = "sensor_msgs/msg/JointState", "sensor_msgs/msg/CompressedImage"


def shifted(source: Path, out: Path, seconds: float = 0.0, joints: bool = True) -> Path:
    """A log's joints and images, with the images' stamps later by some seconds."""
    with logs.open(source) as log, logs.Writer(out) as new:
        table = log["/joint_states"]
        if joints:
            columns = {"header.stamp": table.header.stamp, "name": table.name, "position": table.position}
            new.write("/joint_states", JOINT_STATE, table.log_ns, columns)
        table, data = log[IMAGES], [bytes(one.value.data) for one in log.messages([IMAGES])]
        stamps = table.header.stamp + round(1e9 * seconds)
        new.write(IMAGES, COMPRESSED, table.log_ns, {"header.stamp": stamps, "format": "jpeg", "data": data})
    return out


@pytest.fixture(scope="module")
def body(tmp_path_factory) -> Path:
    """The body of the small arm."""
    path = tmp_path_factory.mktemp("body") / "body.npz"
    pipeline.fit([ARM / "explore.mcap"], path, Settings())
    return path


def measured(result):
    """Delay and its standard error, s."""
    values = {score.name: score.value for score in result.scores}
    assert {score.unit for score in result.scores} == {"s"}
    return values["delay/camera"], values["std/delay/camera"]


@pytest.mark.parametrize("with_body", first_of(1, [True, False]))
@pytest.mark.parametrize("name", ["explore.mcap", "reach.mcap"])
def test_doctor_accuses_no_sound_log(name, with_body, body):
    found = pipeline.diagnose_log(ARM / name, None, Settings(), body=body if with_body else None)
    late, error = measured(found)
    assert abs(late) < 3 * error < 0.01
    (remark,) = found.findings
    assert remark.severity == "info" and "not significant" in remark.text


@pytest.mark.parametrize(("with_body", "seconds"), [(False, 0.08), (False, -0.15), (True, 0.06)])
def test_doctor_finds_late_images(with_body, seconds, body, tmp_path):
    log = shifted(ARM / "reach.mcap", tmp_path / "late.mcap", seconds)
    found = pipeline.diagnose_log(log, None, Settings(), body=body if with_body else None)
    late, error = measured(found)
    assert abs(late - seconds) < 3 * error < 0.01
    (warning,) = (one for one in found.findings if one.severity == "warning")
    way = "lag" if seconds > 0 else "lead"
    assert f"camera: image timestamps {way} the encoders by {abs(late):.4f} ± {error:.4f} s" in warning.text
    assert "fit and estimate measure and correct it" in warning.text


def test_doctor_compares_with_the_delay_that_is_given(body, tmp_path):
    log = shifted(ARM / "reach.mcap", tmp_path / "late.mcap", 0.06)
    for given, severity, text in (({"camera": 0.06}, "info", "0.06 s is expected"),
                                  ({"camera": 0.0}, "warning", "not 0 s; type --delay camera=0.0")):  # fmt: skip
        for known in (None, body):
            found = pipeline.diagnose_log(log, None, Settings(time=TimeSettings(delay=given)), body=known)
            (remark,) = (one for one in found.findings if "image timestamps" in one.text)
            assert (remark.severity, text in remark.text) == (severity, True), remark
            assert abs(measured(found)[0] - 0.06) < 0.01


def test_doctor_says_why_it_measures_no_delay(body, tmp_path):
    still = tmp_path / "still.mcap"
    with logs.open(ARM / "reach.mcap") as log, logs.Writer(still) as new:
        table, stamps = log["/joint_states"], log[IMAGES].header.stamp
        columns = {"header.stamp": table.header.stamp, "name": table.name, "position": 0 * table.position}
        new.write("/joint_states", JOINT_STATE, table.log_ns, columns)
        data = [bytes(one.value.data) for one in log.messages([IMAGES])]
        new.write(IMAGES, COMPRESSED, stamps, {"header.stamp": stamps, "format": "jpeg", "data": data})
    alone = shifted(ARM / "reach.mcap", tmp_path / "alone.mcap", joints=False)
    assert "not measured: no joint moved" in pipeline.diagnose_log(still, None, Settings()).findings[-1].text
    text = pipeline.diagnose_log(still, None, Settings(), body=body).findings[-1].text
    assert "camera: delay not measured" in text and "--body" not in text
    assert not pipeline.diagnose_log(alone, None, Settings()).findings
    assert "no moving joints" in pipeline.diagnose_log(alone, None, Settings(), body=body).findings[-1].text


def test_doctor_looks_at_part_of_a_long_log():
    from bodylog.recording import recording

    read = recording.read_recording(ARM / "explore.mcap", Settings())
    part = delay_findings.middle_of_recording(change_recording(read, views={"side": read.cameras.frames}), 10.0, 50)
    t = [frame.t for frame in part.cameras.frames()]
    assert 30 <= len(t) <= 40 and 14.9 < t[0] < 15.3 and 24.5 < t[-1] < 25.1
    joints = part.signals.joints
    assert np.ptp(joints.t) <= 10.0 and len(joints.t) == len(joints.values) == len(joints.source_ns)
    assert list(part.cameras.views) == ["side"]


def test_doctor_prints_the_delay(run_cli, body, tmp_path, capsys):
    log = shifted(ARM / "reach.mcap", tmp_path / "late.mcap", 0.06)
    assert run_cli("doctor", log, "--body", body, "--json") == 0
    (entry,) = json.loads(capsys.readouterr().out)["results"]
    assert entry["scores"]["delay/camera"] == {
        "value": pytest.approx(0.06, abs=0.01), "unit": "s", "std": entry["scores"]["std/delay/camera"]["value"],
    }  # fmt: skip
    assert run_cli("doctor", ARM / "reach.mcap", "--delay", "off") == 0
    assert capsys.readouterr().out == f"{ARM / 'reach.mcap'}: sound\n"
    assert run_cli("doctor", log, "--body", log) == 65

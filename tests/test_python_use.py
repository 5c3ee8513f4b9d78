"""What a user of Python types: text for paths, no settings, names instead of numbers."""

import subprocess
import sys

import numpy as np
import pytest

import bodylog
import bodylog.logs as logs
from bodylog.errors import ConfigError
from bodylog.estimation.measurements.reading_units import find_joint_unit
from bodylog.findings.result import Scores
from bodylog.settings import Settings
from bodylog.types import LazyImage, Score, Series

IMAGES = "/camera/color/image_raw/compressed"


def test_the_package_runs_as_a_module():
    ended = subprocess.run([sys.executable, "-m", "bodylog", "--version"], capture_output=True, text=True)
    assert ended.returncode == 0 and ended.stdout.startswith("bodylog, version")


def test_paths_may_be_text_and_settings_may_be_left_out(arm, arm_body):
    body = bodylog.load_body(str(arm_body))
    result = bodylog.estimate(str(arm / "reach.mcap"), str(arm_body))
    assert result.output is None and result.verdict[0].startswith("no fault found in ")
    assert result.scores["rmse/joint"].value < 0.05 and "rmse/joint" in result.scores
    assert dict(result.scores)["rmse/joint"].unit == "rad" and result.scores.get("rmse/jiont") is None
    assert [score.name for score in result.scores] == result.scores.keys()
    estimator = bodylog.Estimator(body)
    belief = estimator.step(0.0, joints=dict.fromkeys(body.joints, 0.0))
    assert belief.joints == body.joints and len(belief.x) == len(belief.joints)


def test_what_is_no_path_is_refused_with_its_name(arm, arm_body):
    body = bodylog.load_body(str(arm_body))
    with pytest.raises(TypeError, match="estimate: body is a BodyModel; a path is expected"):
        bodylog.estimate(arm / "reach.mcap", body)


def test_a_score_that_is_not_there_is_a_key_error_with_the_names():
    scores = Scores((Score("nis/encoders", 1.0, "1"),))
    assert scores[0] is scores["nis/encoders"]
    with pytest.raises(KeyError, match="there are nis/encoders"):
        scores["rmse/joint"]


def test_settings_may_be_mappings_and_are_checked():
    assert Settings(estimate={"method": "smoother"}).estimate.method == "smoother"
    with pytest.raises(ConfigError, match=r"'smother'.*did you mean smoother"):
        Settings(estimate={"method": "smother"})
    with pytest.raises(ConfigError, match="did you mean method"):
        Settings(estimate={"metod": "smoother"})
    with pytest.raises(ConfigError, match=r"Settings: features\.wrist"):
        Settings(features={"wrist": 7})


def test_a_frame_is_printed_without_its_bytes():
    frame = LazyImage(0.5, 1, lambda _: np.zeros((2, 2, 3), np.uint8))
    assert repr(frame) == "LazyImage(t=0.5, source_ns=1, shrinks=False)"


def test_image_tables_of_a_log_are_written_as_they_were_read(arm, tmp_path):
    read = logs.open(str(arm / "reach.mcap"))
    table = read[IMAGES]
    with logs.Writer(str(tmp_path / "again.mcap")) as out:
        fields = {name: table[name] for name in ("header.stamp", "header.frame_id", "format", "data")}
        out.write(IMAGES, "sensor_msgs/msg/CompressedImage", table.log_ns, fields)
    again = logs.open(str(tmp_path / "again.mcap"))
    assert [bytes(one) for one in again[IMAGES]["data"]] == [bytes(one) for one in table["data"]]
    ours, theirs = (next(iter(log.frames(IMAGES))) for log in (again, read))
    assert np.array_equal(ours.image, theirs.image)


@pytest.mark.parametrize(
    ("values", "unit", "expected"),
    [
        ([-1.0, 2.0], "rad", ("rad", 1.0)),
        ([855.0, 3278.0], "counts", ("counts", 2 * np.pi / 4096)),
        ([855.0, 3278.0], "rad", ("counts", 2 * np.pi / 4096)),
        ([-98.5, 99.1], "unknown", ("unknown", 2 * np.pi / 256)),
        ([0.0, 62.5], "rad", ("rad", 1.0)),
    ],
)
def test_the_size_of_a_unit_follows_from_the_readings(values, unit, expected):
    joints = Series(np.arange(2.0), np.array(values)[:, None], ("j",), unit, np.arange(2))
    assert find_joint_unit(joints) == expected

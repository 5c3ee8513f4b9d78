"""What cannot be used is refused in one line that begins with the file."""

import os
import subprocess
import sys

import numpy as np
import pytest

from ..logs.writing import T0, camera, compressed, joint_state, joints, write

JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")


def _log(path, names=JOINTS, count=200, picture=None):
    """A log of `count` postures and as many pictures, none for None."""
    times = [T0 + index * 20_000_000 for index in range(count)]
    angles = [np.sin(index / 9 + np.arange(len(names))) for index in range(count)]
    readings = [(ns, joint_state(ns, names, q)) for ns, q in zip(times, angles, strict=True)]
    seen = [] if picture is None else [camera("/camera", [(ns, compressed(ns, picture)) for ns in times])]
    return write(path, [*([joints("/joint_states", readings)] if names else []), *seen])


@pytest.fixture
def logs(tmp_path):
    """A folder of logs that lack something."""
    grey = np.full((48, 64, 3), 90, np.uint8)
    _log(tmp_path / "blind.mcap")
    _log(tmp_path / "still.mcap", count=1)
    _log(tmp_path / "other.mcap", names=(JOINTS[0], "knee"))
    _log(tmp_path / "grey.mcap", names=(), count=9, picture=grey)
    return tmp_path


CASES = {
    "fit blind.mcap -o out.npz": "{0}/blind.mcap: no track to learn from, though 3 joints moved (",
    "fit blind.mcap still.mcap -o out.npz": "{0}/blind.mcap and 1 more: no ",
    "fit still.mcap -o out.npz": "{0}/still.mcap: no track to learn from, and no joint moved; type: ",
    "compare other.mcap --body body.npz": "{0}/other.mcap: joints: the body model knows ",
    "colours blind.mcap": "{0}/blind.mcap: no pictures to look for features in; type: ",
    "colours grey.mcap -o out.png": "{0}/grey.mcap: no tag and no colour in ",
    "plot grey.mcap -o out.png": "{0}/grey.mcap: no joints, tracks, skin or events to draw; type: ",
    "extract blind.mcap -o out.mcap": "{0}/blind.mcap: neither camera nor skin gave anything to extract; type: ",
}


@pytest.mark.parametrize("typed", CASES)
def test_refusal_begins_with_the_log(capsys, run_cli, robot, logs, typed):
    body = robot / "body.npz"
    words = [body if word == "body.npz" else logs / word if "." in word else word for word in typed.split()]
    capsys.readouterr()
    assert run_cli(*words) == 65
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and printed.startswith("bodylog: " + CASES[typed].format(logs)), printed
    assert not list(logs.glob("out*"))


@pytest.mark.parametrize(
    "typed",
    [
        "estimate pipe.mcap --body body.npz -o out.mcap",
        "extract pipe.mcap -o out.mcap",
        "fit pipe.mcap -o out.npz",
        "batch pipe.mcap --body body.npz -o out",
        "batch reach.mcap --train pipe.mcap -o out",
    ],
)
def test_pipe_is_refused_without_waiting(tmp_path, robot, typed):
    os.mkfifo(tmp_path / "pipe.mcap")
    known = {"pipe.mcap": tmp_path / "pipe.mcap", "body.npz": robot / "body.npz", "reach.mcap": robot / "reach.mcap"}
    words = [known.get(word, tmp_path / word if word.startswith("out") else word) for word in typed.split()]
    command = [sys.executable, "-m", "bodylog_cli", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 65
    assert f"{tmp_path / 'pipe.mcap'}: is a pipe or device" in done.stderr and "Traceback" not in done.stderr

"""What cannot be used is refused in one line that begins with the file."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from bodylog.body import storage

from ..logs.writing import (
    T0,
    Stream,
    camera,
    cdr,
    compressed,
    define,
    header,
    joint_state,
    joints,
    write,
)

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
    rows = "".join(f"{0.1 * k},{0.2 * k}\n" for k in range(3))
    (tmp_path / "poses.csv").write_text(f"pan,lift\n{rows}")
    return tmp_path


CASES = {
    "fit blind.mcap -o out.npz": "{0}/blind.mcap: no images and no tracks in it, only 3 joints (",
    "fit blind.mcap still.mcap -o out.npz": "{0}/blind.mcap and 1 more: no ",
    "fit poses.csv -o out.npz": "{0}/poses.csv: no images and no tracks in it, only 2 joints (pan, lift) in 3 poses; ",
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


def test_fit_says_what_a_log_without_images_lacks(tmp_path, capsys, run_cli, logs):
    blind, poses = logs / "blind.mcap", logs / "poses.csv"
    kind = "foxglove_msgs/msg/CompressedVideo"
    packets = Stream("/film", kind, define("std_msgs/msg/String"), [(T0, cdr("std_msgs/msg/String", data="x"))])
    stream = joints("/joint_states", [(T0 + k, joint_state(T0 + k, ("pan",), [0.1 * k])) for k in range(9)])
    film = write(tmp_path / "film.mcap", [stream, packets])
    point = "geometry_msgs/msg/PointStamped"
    place = cdr(point, header=header(T0), point=("geometry_msgs/msg/Point", {"x": 1.0, "y": 2.0, "z": 0.0}))
    places = [Stream(topic, point, define(point), [(T0, place)]) for topic in ("/truth/tip", "/tip")]
    pointed = write(tmp_path / "pointed.mcap", [stream, *places])
    expected_errors = {
        pointed: ("only 1 joint (pan)", 'name it in robot.toml: [features] effector = { topic = "/tip" }'),
        blind: (" for 4.0 s; a body is learned from joints and ", f"type: bodylog estimate {blind} -o out.mcap\n"),
        poses: (" in 3 poses; ", ": add columns NAME_u and NAME_v (px) of a marker, NAME_x, NAME_y and NAME_z (m) "),
        film: ("only 1 joint (pan)", "; /film holds a video's packets, not images; "),
    }
    for log, texts in expected_errors.items():
        capsys.readouterr()
        assert run_cli("fit", log, "-o", tmp_path / "out.npz") == 65
        printed = capsys.readouterr().err
        assert printed.count("\n") == 1 and all(text in printed for text in texts), printed


def test_fit_of_a_dataset_without_its_videos_names_them(tmp_path, capsys, run_cli):
    from ..logs.datasets import drawn

    dataset = drawn.v21(tmp_path / "arm", [60])
    shutil.rmtree(dataset / "videos")
    capsys.readouterr()
    assert run_cli("fit", dataset, "-o", tmp_path / "out.npz") == 65
    printed = capsys.readouterr().err.splitlines()[-1]
    assert "no images and no tracks in it, only 3 joints" in printed
    assert printed.endswith(".mp4: there is no such file; is the dataset downloaded completely?")


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


@pytest.mark.parametrize("thing", ["something green", "tag 7 of apriltag_36h11"])
def test_estimate_says_what_the_body_looks_for_and_never_sees(tmp_path, capsys, run_cli, robot, thing):
    body, bare = storage.load_body(robot / "body.npz"), np.full((120, 160, 3), 90, np.uint8)
    log = _log(tmp_path / "bare.mcap", count=60, picture=bare)
    if "tag" in thing:
        settings = json.loads(body.provenance["settings"]) | {"features": {"effector": {"tag": 7}}}
        body = replace(body, provenance={**body.provenance, "settings": json.dumps(settings)})
    storage.save(body, tmp_path / "body.npz")
    capsys.readouterr()
    typed = ("estimate", log, "--body", tmp_path / "body.npz", "-o", tmp_path / "out.mcap")
    assert run_cli(*typed) == 3
    printed = capsys.readouterr().err
    expected_error = f"lost: the body looks for {thing} (effector); it was never seen in 60 images: "
    assert f"{expected_error}the estimate is of the encoders alone\n" in printed
    assert run_cli(*typed, "--without", "vision") == 0
    assert "never seen" not in capsys.readouterr().err

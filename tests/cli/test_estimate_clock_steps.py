"""Clocks that NTP sets back while a log is recorded: the step is named, and no sound encoder or
camera is accused.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from .stepped import set_back

ARM = Path(__file__).parents[2] / "fixtures" / "arm"
JOINTS, CAMERA = "/joint_states", "/camera/color/image_raw/compressed"
WHICH = {
    "all clocks": (None, True),
    "all but the recorder's": (None, False),
    "the recorder's": ((), True),
    "the joints'": ((JOINTS,), False),
    "the camera's": ((CAMERA,), False),
}
"""Topics whose stamps step, and whether log times do."""


@pytest.fixture(scope="module")
def body(tmp_path_factory, run_cli):
    path = tmp_path_factory.mktemp("stepped") / "body.npz"
    assert run_cli("fit", ARM / "explore.mcap", "-o", path) == 0
    return path


def _assert_named_and_mended(tmp_path, capsys, run_cli, body, which, at, by, seed):
    """The log's estimate is that of the same log without a step, and each stream that stepped says
    so; `by` s back, or forward if negative.
    """
    topics, recorder = WHICH[which]
    log = set_back(
        ARM / "reach.mcap", tmp_path / "log.mcap", at, by, topics, recorder, jitter=0.004, seed=seed
    )
    capsys.readouterr()
    assert run_cli("estimate", log, "--body", body, "-o", tmp_path / "out.mcap", "--json") == 0
    result = json.loads(capsys.readouterr().out)["results"][0]
    assert not result["faults"]
    scores = {name: one["value"] for name, one in result["scores"].items()}
    assert (
        scores["rmse/joint"] < 0.0075
        and scores["nees/joint"] < 1.4
        and scores["used/encoders"] == 1000
    )
    way = "back" if by > 0 else "forward"
    stepped = [one["text"] for one in result["findings"] if f"stepped {way}" in one["text"]]
    for topic in (JOINTS, CAMERA):
        texts = [text for text in stepped if f" {topic}:" in text]
        if topics is None or topic in topics or recorder:
            (text,) = texts
            size, when = (float(text.partition(word)[2].split()[0]) for word in (f"{way} by", "s, "))
            assert size == pytest.approx(abs(by), abs=0.015) and when == pytest.approx(at, abs=0.15)
        else:
            assert not texts


@pytest.mark.parametrize(
    ("which", "at", "by"),
    [
        ("all clocks", 6.0, 0.3),
        ("all but the recorder's", 3.0, 0.2),
        ("the joints'", 12.0, 4.7),
        ("the camera's", 17.0, 0.4),
        ("the joints'", 8.0, 0.05),
        ("the camera's", 9.0, -0.4),
    ],
)
def test_no_sensor_is_accused_where_a_clock_steps(tmp_path, capsys, run_cli, body, which, at, by):
    _assert_named_and_mended(tmp_path, capsys, run_cli, body, which, at, by, seed=0)


@pytest.mark.soak
@pytest.mark.parametrize("which", WHICH)
@pytest.mark.parametrize("seed", range(8))
def test_no_sensor_is_accused_where_drawn_clocks_step(tmp_path, capsys, run_cli, body, which, seed):
    rng = np.random.default_rng([seed, list(WHICH).index(which)])
    at, by = rng.uniform(1.0, 18.5), float(np.exp(rng.uniform(np.log(0.2), np.log(5.0))))
    _assert_named_and_mended(tmp_path, capsys, run_cli, body, which, at, by, seed)


@pytest.mark.soak
@pytest.mark.parametrize("which", ["all but the recorder's", "the joints'", "the camera's"])
@pytest.mark.parametrize("seed", range(5))
def test_no_sensor_is_accused_where_drawn_clocks_leap(tmp_path, capsys, run_cli, body, which, seed):
    rng = np.random.default_rng([seed, list(WHICH).index(which), 1])
    at, by = rng.uniform(1.0, 18.5), float(np.exp(rng.uniform(np.log(0.1), np.log(5.0))))
    _assert_named_and_mended(tmp_path, capsys, run_cli, body, which, at, -by, seed)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(8))
def test_no_encoder_is_accused_where_its_clock_steps_a_little(
    tmp_path, capsys, run_cli, body, seed
):
    rng = np.random.default_rng([seed, 2])
    at, by = rng.uniform(1.0, 18.5), rng.uniform(0.03, 0.1)
    _assert_named_and_mended(tmp_path, capsys, run_cli, body, "the joints'", at, by, seed)

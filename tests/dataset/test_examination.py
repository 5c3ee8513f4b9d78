"""Delays by the robot's own surface beside those by flow: which is used, and what is pooled."""

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'bodylog[datasets]'")

from bodylog.body import storage
from bodylog.dataset.examination import examine_episode
from bodylog.dataset.judgement import judge_episodes
from bodylog.delays.findings import ExaminedDelays
from bodylog.settings import KinematicsSettings, Settings
from bodylog.surface import findings as surface_findings
from bodylog.types import Fault, Finding, Score

from . import arm_dataset

DELAY_S = 0.063
COUNT = 3


def delays_by_surface(log: Path, _settings: Settings) -> ExaminedDelays:
    """A delay of the first camera; none of the last episode."""
    if log.name.endswith("#2"):
        return ExaminedDelays((), (Finding("info", f"{log}: camera: no arm is seen"),))
    values = {"delay/camera": DELAY_S, "std/delay/camera": 0.001, "row_time/camera": 0.03, "std/row_time/camera": 0.01}
    return ExaminedDelays(tuple(Score(name, value, "s") for name, value in values.items()), ())


def test_the_delay_by_the_surface_is_used_and_pooled_and_flows_stands_beside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = arm_dataset.write(tmp_path / "arm", [arm_dataset.episode(number) for number in range(COUNT)])
    monkeypatch.setattr(surface_findings, "examine_by_surface", delays_by_surface)
    settings = Settings(kinematics=KinematicsSettings(urdf="arm.urdf"))
    rows: list[dict[str, Any]] = []
    evidence = {}
    for number in range(COUNT):
        name = f"arm_{number}"
        result, evidence[name] = examine_episode(Path(f"{folder}#{number}"), settings, name)
        rows.append({"name": name, "exit_code": 0, "verdict": [], "findings": [], "scores": {
            one.name: one.value for one in result.scores
        }})  # fmt: skip
    used = [row["scores"]["delay/top"] for row in rows]
    assert used[:2] == [DELAY_S, DELAY_S] and used[2] != DELAY_S
    assert abs(used[2] - arm_dataset.DELAY_S) < 3.0 * rows[2]["scores"]["std/delay/top"]
    assert ["flow/delay/top" in row["scores"] for row in rows] == [True, True, False]
    assert all("delay/camera" not in row["scores"] for row in rows)
    judged = judge_episodes(rows, evidence)
    pooled = judged.pooled["delay/top"]
    assert pooled.mean == pytest.approx(DELAY_S) and pooled.std < 0.002 and pooled.by_surface == 2
    (text,) = [text for text in judged.verdict if "late against the joints" in text]
    assert "by the robot's surface in 2 of 3 episodes" in text
    assert any("by the picture's motion alone" in text for text in judged.verdict)


def faults_by_body(log: Path, _body: object, _settings: Settings) -> ExaminedDelays:
    """The second joint is off by 5° in the second episode, and the camera moved from the fourth on."""
    faults = []
    if log.name.endswith("#1"):
        faults.append(Fault("encoders", "lift", "offset", 0.0, 0.0873, "rad", 0.003))
    if int(log.name[-1]) > 2:
        faults.append(Fault("vision", "top", "moved", 0.0, float("nan"), "m"))
    return ExaminedDelays((Score("delay/camera", DELAY_S, "s", 0.001),), (), tuple(faults))


def test_an_encoder_that_was_homed_again_is_named_with_its_episode_and_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    episodes = [arm_dataset.episode(0) for _ in range(5)]
    folder = arm_dataset.write(tmp_path / "arm", episodes)
    monkeypatch.setattr(surface_findings, "examine_by_body", faults_by_body)
    monkeypatch.setattr(storage, "load_body", lambda _: None)
    evidence = {}
    rows: list[dict[str, Any]] = []
    for number in range(len(episodes)):
        name = f"arm_{number}"
        log = Path(f"{folder}#{number}")
        result, evidence[name] = examine_episode(log, Settings(), name, tmp_path / "body.npz")
        assert len(result.faults) == (number in (1, 3, 4))
        rows.append({"name": name, "exit_code": 0, "verdict": [], "findings": [], "scores": {}, "log": ""})
    judged = judge_episodes(rows, evidence)
    assert judged.pooled["delay/top"].mean == pytest.approx(DELAY_S)
    (odd,) = judged.outliers
    assert (odd.episode, odd.figures) == ("arm_1", ("offset/lift",))
    assert "lift: its encoder has another zero than the body that is given" in odd.text
    assert "(+5 ± 0.17°)" in odd.text
    (lasting,) = [text for text in judged.findings if "it stands elsewhere" in text]
    assert lasting.endswith("it stands elsewhere before the arm than the body that is given, from arm_3 on")

    # what the episodes from one on tell together stands for what single ones of them tell
    fault = Fault("encoders", "lift", "offset", 0.0, 0.05, "rad", 0.001)
    judged = judge_episodes(rows, evidence, (), [("arm_1", fault)])
    assert not judged.outliers
    (text,) = [text for text in judged.findings if "lift" in text]
    assert text.endswith("(+2.86 ± 0.057°), from arm_1 on, by these episodes together")
    judged = judge_episodes(rows, evidence, (), [("arm_2", fault)])
    assert [one.episode for one in judged.outliers] == ["arm_1"]

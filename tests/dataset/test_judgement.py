"""Drawn datasets: sound ones accuse nobody; one fault in one episode is found, and nothing else."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'bodylog[datasets]'")


from bodylog.dataset.judgement import OTHER_MOTION, judge_episodes
from bodylog.dataset.siblings import OTHER_DELAY_NATS
from bodylog.delays.flow_delay import list_tried_delays
from tests.dataset.judged_episodes import examined, judged

from . import arm_dataset

EPISODES = 8
FAULTY = 4


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Any]:
    """Rows and evidence of sound episodes."""
    folder = arm_dataset.write(
        tmp_path_factory.mktemp("sound"), [arm_dataset.episode(k) for k in range(EPISODES)]
    )
    return {number: examined(folder, number, number) for number in range(EPISODES)}


def test_no_episode_of_a_sound_dataset_is_accused(sound: dict[int, Any]) -> None:
    found = judged(sound)
    assert not found.outliers
    pooled = found.pooled["delay/top"]
    assert abs(pooled.mean - arm_dataset.DELAY_S) < 2.0 * pooled.std
    action = found.pooled["delay/action"]
    assert abs(action.mean - arm_dataset.LEAD_S) < 0.005


@pytest.mark.parametrize("fault", arm_dataset.FAULTS)
def test_a_fault_of_one_episode_is_found_and_nothing_else(
    fault: str, sound: dict[int, Any], tmp_path: Path
) -> None:
    change, figure = arm_dataset.FAULTS[fault]
    faulty = change(arm_dataset.episode(FAULTY), FAULTY)
    folder = arm_dataset.write(tmp_path, [faulty])
    found = judged({**sound, FAULTY: examined(folder, 0, FAULTY)})
    assert {one.episode for one in found.outliers} == {str(FAULTY)}
    assert figure in {name for one in found.outliers for name in one.figures}
    assert len(found.outliers) == 1, [one.text for one in found.outliers]


def rolled_episodes(row_times_s: list[float]) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Rows and evidence of a camera whose delay is 0.1 s at a row time of 0.06 s, where every second episode shows
    what is above the middle and every other one what is below it, each with the delay of its own row time."""
    evidence, rows = {}, []
    for number, row_time in enumerate(row_times_s):
        share = -0.3 if number % 2 else 0.2
        delay = 0.1 + share * (row_time - 0.06)
        std = float(np.hypot(0.002, abs(share) * 0.02))
        figures = {"delay/top": [delay, std, abs(share) * 0.02, None], "row_time/top": [row_time, 0.02, 0.0, None]}
        about = {"view": None, "size": None, "stored_hz": None, "thumbnails": []}
        evidence[str(number)] = {
            "figures": figures,
            "joints": None,
            "action": None,
            "cameras": {"top": about},
            "digest": None,
            "duration_s": 10.0,
            "by_surface": ["delay/top", "row_time/top"],
            "row_shares": {"delay/top": [share, row_time]},
        }
        scores = {"delay/top": delay, "std/delay/top": std}
        rows.append({"name": str(number), "exit_code": 0, "findings": [], "verdict": [], "scores": scores})
    return rows, evidence


def test_delays_of_episodes_have_the_row_time_of_all() -> None:
    row_times_s = [0.03, 0.04, 0.05, 0.07, 0.08, 0.09, 0.05, 0.07]
    rows, evidence = rolled_episodes(row_times_s)
    found = judge_episodes(rows, evidence)
    delays = [row["scores"]["delay/top"] for row in found.rows]
    assert max(abs(np.array([row["scores"]["delay/top"] for row in rows]) - 0.1)) > 0.006
    np.testing.assert_allclose(delays, 0.1, atol=1e-9)
    for row, one in zip(found.rows, rows, strict=True):
        assert row["scores"]["std/delay/top"] < one["scores"]["std/delay/top"]
    text = found.rows[1]["findings"][0][1]
    assert text.startswith("delay/top: 100.0 ± ") and "alone 106.0 ± 6.3 ms" in text
    assert found.pooled["delay/top"].mean == pytest.approx(0.1)


def test_delays_of_few_episodes_stay_as_they_are() -> None:
    rows, evidence = rolled_episodes([0.03, 0.09, 0.05])
    assert judge_episodes(rows, evidence).rows == rows


def flow_episodes(delays_s: list[float], nats: float, motions: list[float]) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Rows and evidence of a camera whose delays by flow have an error of 4 ms, while the likelihood of delays 40 ms
    away is by `nats` less; its picture moves with the joints by `motions`."""
    evidence, rows = {}, []
    for number, (delay, motion) in enumerate(zip(delays_s, motions, strict=True)):
        profile = -nats * np.minimum(np.abs(list_tried_delays() - delay) / 0.04, 1.0) ** 2
        about = {"view": None, "size": None, "stored_hz": None, "thumbnails": []}
        evidence[str(number)] = {
            "figures": {"delay/top": [delay, 0.004, 0.0, None]},
            "joints": None,
            "action": None,
            "cameras": {"top": about | {"delay_profile": profile.tolist(), "flow_per_motion": motion}},
            "digest": None,
            "duration_s": 10.0,
        }
        scores = {"delay/top": delay, "std/delay/top": 0.004}
        rows.append({"name": str(number), "exit_code": 0, "findings": [], "verdict": [], "scores": scores})
    return rows, evidence


LATE_S = [0.02, 0.02, 0.12, 0.02, 0.02, 0.02, 0.02, 0.02]


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_a_late_camera_is_accused_where_the_likelihood_of_all_episodes_confirms_it(share: float) -> None:
    found = judge_episodes(*flow_episodes(LATE_S, share * OTHER_DELAY_NATS, [1.0] * 8))
    assert [one.episode for one in found.outliers] == (["2"] if share > 1.0 else [])
    assert share > 1.0 or any("differ from the others" in text and "delay/top" in text for text in found.verdict)
    assert found.pooled["delay/top"].mean == pytest.approx(0.02)


@pytest.mark.parametrize("motion", [0.9 * OTHER_MOTION, 1.1 * OTHER_MOTION, 1.0 / (1.1 * OTHER_MOTION)])
def test_a_picture_in_which_something_else_moves_accuses_no_episode(motion: float) -> None:
    motions = [motion if delay > 0.1 else 1.0 for delay in LATE_S]
    found = judge_episodes(*flow_episodes(LATE_S, 2.0 * OTHER_DELAY_NATS, motions))
    assert bool(found.outliers) == (1.0 < motion < OTHER_MOTION)

"""Drawn datasets: sound ones accuse nobody; one fault in one episode is found, and nothing else."""

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'bodylog[datasets]'")


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

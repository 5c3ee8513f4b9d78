"""Checks of a joint's readings against its action."""

from typing import cast

import numpy as np

from bodylog.dataset.joint_checks import measure_joint_standstills
from bodylog.dataset.reading import EpisodeReading, StoredNumbers
from bodylog.types import Recording

RATE_HZ = 20.0


def reading_of(state: np.ndarray, action: np.ndarray) -> EpisodeReading:
    """An episode of joints a, b, … with states and actions (N,K)."""
    t = np.arange(len(state)) / RATE_HZ
    names = tuple("abc"[: state.shape[1]])
    joints, wanted = (StoredNumbers(t, values, names, "rad") for values in (state, action))
    return EpisodeReading(joints, wanted, {}, cast(Recording, None), len(t))


def test_a_joint_stands_still_while_its_action_moves_and_not_while_that_rests() -> None:
    t = np.arange(200) / RATE_HZ
    wanted = np.column_stack([0.1 * t, np.sin(np.clip(t, 0.0, 4.0)), np.zeros(200)])
    state = wanted.copy()
    state[60:120, 0] = state[60, 0]
    found = {one.part: one for one in measure_joint_standstills(reading_of(state, wanted))}
    assert set(found) == {"a", "b"}
    assert abs(found["a"].value - 59 / RATE_HZ) < 1e-9 and found["a"].at == state[60, 0]
    assert found["a"].text.startswith("a: repeats 0.3 from 3.00 to 5.95 s while its action moves")
    assert found["b"].value <= 0.2 and not found["b"].text


def test_a_joint_without_an_action_of_its_name_has_no_standstill() -> None:
    reading = reading_of(np.zeros((50, 1)) + np.arange(50)[:, None] // 30, np.ones((50, 1)))
    assert not list(measure_joint_standstills(EpisodeReading(reading.joints, None, {}, reading.read, 50)))
    assert [one.value for one in measure_joint_standstills(reading)] == [0.0]

"""The first joint's encoder drifts away from 8 s on, to 0.3 rad at 24 s, and stays there."""

import numpy as np

from ...types import Array
from ..plan import (
    Request,
    Scenario,
    ScenarioPlan,
    plan_reaches,
    read_angles_with_noise,
    swing_of_joints,
)

_FROM = 8.0
_TO = 24.0
_SIZE = 0.3


def _drifting_encoders(t: Array, q: Array, noise: Array) -> Array:
    reading = read_angles_with_noise(t, q, noise)
    reading[:, 0] += _SIZE * np.clip((t - _FROM) / (_TO - _FROM), 0.0, 1.0)
    return reading


def _plan_drift(request: Request) -> ScenarioPlan:
    return ScenarioPlan(plan_reaches(request, swing_of_joints(request)), 0.01, _drifting_encoders)


SCENARIO = Scenario("the first encoder drifts from 8 s on", _plan_drift, 30.0)

"""The first joint's encoder drifts away from 8 s on, to 0.3 rad at 24 s, and stays there."""

import numpy as np

from ...types import Array
from ..plan import Plan, Request, Scenario, plain, reach, swing

_FROM, _TO, _SIZE = 8.0, 24.0, 0.3


def _encoders(t: Array, q: Array, noise: Array) -> Array:
    reading = plain(t, q, noise)
    reading[:, 0] += _SIZE * np.clip((t - _FROM) / (_TO - _FROM), 0.0, 1.0)
    return reading


def _plan(request: Request) -> Plan:
    return Plan(reach(request, swing(request)), 0.01, _encoders)


SCENARIO = Scenario("the first encoder drifts from 8 s on", _plan, 30.0)

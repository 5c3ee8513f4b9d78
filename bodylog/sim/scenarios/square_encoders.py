"""Encoders that read the square of the angle: its size is identifiable, its sign is not."""

import numpy as np

from ...types import Array
from ..motion import still
from ..plan import Plan, Request, Scenario, explore, swing


def _plan(request: Request) -> Plan:
    squared = swing(request) > 0

    def encoders(t: Array, q: Array, noise: Array) -> Array:
        return np.where(squared, q**2, q) + noise

    if request.variant == "moving":
        return Plan(explore(request, swing(request)), 0.003, encoders)
    return Plan(still(np.array(request.arm.home)), 0.01, encoders)


SCENARIO = Scenario("encoders read x squared", _plan, 15.0, variants=("still", "moving"))

"""A still arm, stroked next to its end effector; images in time with the skin, or late."""

import numpy as np

from ..motion import still
from ..plan import Plan, Request, Scenario, plain, strokes

_DELAYS = {"synchronous": (0.0, 0.0), "late": (0.6, 0.6), "jitter": (0.0, 0.1), "wide-jitter": (0.0, 1.0)}


def _plan(request: Request) -> Plan:
    low, high = _DELAYS[request.variant]
    contacts = strokes(request, 2.0, lambda: request.rng.uniform(low, high))
    return Plan(still(np.array(request.arm.home)), 0.01, plain, contacts)


SCENARIO = Scenario("strokes near the end effector of a still arm", _plan, 30.0, variants=tuple(_DELAYS))

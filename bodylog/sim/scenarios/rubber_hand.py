"""The rubber-hand illusion: a hidden, still arm is stroked while the image shows a hand stroke another place.

Five seconds without touch, then strokes; asynchronous images are 0.4 to 1 s late.
"""

import numpy as np

from ..motion import still
from ..plan import Plan, Request, Scenario, plain, strokes

_DELAYS = {"synchronous": (0.0, 0.0), "asynchronous": (0.4, 1.0)}
_ASIDE = {"left": -0.12, "centre": 0.0, "right": 0.12}


def _plan(request: Request) -> Plan:
    low, high = _DELAYS[request.variant]
    contacts = strokes(request, 5.0 + 0.8, lambda: request.rng.uniform(low, high))
    pose = still(np.array(request.arm.home))
    covered = (-1.0, request.duration + 1.0)
    return Plan(pose, 0.01, plain, contacts, covered, 0.36, _ASIDE[request.place])


SCENARIO = Scenario(
    "a hidden arm is stroked, the picture shows it elsewhere",
    _plan,
    40.0,
    variants=tuple(_DELAYS),
    places=("right", "left", "centre"),
)

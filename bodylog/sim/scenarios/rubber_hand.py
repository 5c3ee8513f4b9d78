"""The rubber-hand illusion: a hidden, still arm is
stroked while the image shows a hand stroke another place.

Five seconds without touch, then strokes; asynchronous images are 0.4 to 1 s late.
"""

import numpy as np

from ..motion import stand_still
from ..plan import Request, Scenario, ScenarioPlan, plan_strokes, read_angles_with_noise

_DELAYS = {"synchronous": (0.0, 0.0), "asynchronous": (0.4, 1.0)}
_ASIDE = {"left": -0.12, "centre": 0.0, "right": 0.12}


def _plan_rubber_hand(request: Request) -> ScenarioPlan:
    low, high = _DELAYS[request.variant]
    contacts = plan_strokes(request, 5.0 + 0.8, lambda: request.rng.uniform(low, high))
    pose = stand_still(np.array(request.arm.home))
    covered = (-1.0, request.duration + 1.0)
    return ScenarioPlan(
        pose, 0.01, read_angles_with_noise, contacts, covered, 0.36, _ASIDE[request.place]
    )


SCENARIO = Scenario(
    "a hidden arm is stroked, the picture shows it elsewhere",
    _plan_rubber_hand,
    40.0,
    variants=tuple(_DELAYS),
    places=("right", "left", "centre"),
)

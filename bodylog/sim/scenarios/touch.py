"""A still arm, stroked next to its end effector; images in time with the skin, or late."""

import numpy as np

from ..motion import stand_still
from ..plan import Request, Scenario, ScenarioPlan, plan_strokes, read_angles_with_noise

_DELAYS = {
    "synchronous": (0.0, 0.0),
    "late": (0.6, 0.6),
    "jitter": (0.0, 0.1),
    "wide-jitter": (0.0, 1.0),
}


def _plan_touch(request: Request) -> ScenarioPlan:
    low, high = _DELAYS[request.variant]
    contacts = plan_strokes(request, 2.0, lambda: request.rng.uniform(low, high))
    return ScenarioPlan(
        stand_still(np.array(request.arm.home)), 0.01, read_angles_with_noise, contacts
    )


SCENARIO = Scenario(
    "strokes near the end effector of a still arm", _plan_touch, 30.0, variants=tuple(_DELAYS)
)

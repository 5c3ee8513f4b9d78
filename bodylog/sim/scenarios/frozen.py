"""An encoder freezes at 8 s: from then on it repeats one value, to the last bit."""

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


def _plan_frozen(request: Request) -> ScenarioPlan:
    motion = plan_reaches(request, swing_of_joints(request))
    joint = request.arm.elbow if request.variant == "elbow" else 0
    last = float(motion.position(np.array([_FROM]))[0, joint])

    def encoders(t: Array, q: Array, noise: Array) -> Array:
        reading = read_angles_with_noise(t, q, noise)
        reading[t >= _FROM, joint] = last
        return reading

    return ScenarioPlan(motion, 0.01, encoders)


SCENARIO = Scenario("an encoder freezes at 8 s", _plan_frozen, 30.0, variants=("elbow", "first"))

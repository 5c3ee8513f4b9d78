"""An encoder freezes at 8 s: from then on it repeats one value, to the last bit."""

import numpy as np

from ...types import Array
from ..plan import Plan, Request, Scenario, plain, reach, swing

_FROM = 8.0


def _plan(request: Request) -> Plan:
    motion = reach(request, swing(request))
    joint = request.arm.elbow if request.variant == "elbow" else 0
    last = float(motion.position(np.array([_FROM]))[0, joint])

    def encoders(t: Array, q: Array, noise: Array) -> Array:
        reading = plain(t, q, noise)
        reading[t >= _FROM, joint] = last
        return reading

    return Plan(motion, 0.01, encoders)


SCENARIO = Scenario("an encoder freezes at 8 s", _plan, 30.0, variants=("elbow", "first"))

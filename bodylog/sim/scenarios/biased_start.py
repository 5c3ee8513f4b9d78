"""A still arm whose encoders start with wrong angles while a hand strokes it: how each sense corrects the start."""

import numpy as np

from ...types import Array
from ..motion import still
from ..plan import Plan, Request, Scenario, plain, strokes, swing

_SETTLED = 0.5


def _plan(request: Request) -> Plan:
    moved = swing(request) > 0
    offset = moved * request.rng.choice([-1.0, 1.0], len(moved)) * request.rng.uniform(0.1, 0.2, len(moved))
    until = _SETTLED if request.variant == "settling" else np.inf

    def encoders(t: Array, q: Array, noise: Array) -> Array:
        return np.asarray(plain(t, q, noise) + np.where(t < until, 1.0, 0.0)[:, None] * offset)

    return Plan(still(np.array(request.arm.home)), 0.02, encoders, strokes(request, 3.0, lambda: 0.0))


SCENARIO = Scenario("encoders wrong for 0.5 s, or for good", _plan, 20.0, variants=("settling", "constant"))

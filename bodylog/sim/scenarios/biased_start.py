"""A still arm whose encoders start with wrong angles while
a hand strokes it: how each sense corrects the start.
"""

import numpy as np

from ...types import Array
from ..motion import stand_still
from ..plan import (
    Request,
    Scenario,
    ScenarioPlan,
    plan_strokes,
    read_angles_with_noise,
    swing_of_joints,
)

_SETTLED = 0.5


def _plan_biased_start(request: Request) -> ScenarioPlan:
    moved = swing_of_joints(request) > 0
    offset = (
        moved
        * request.rng.choice([-1.0, 1.0], len(moved))
        * request.rng.uniform(0.1, 0.2, len(moved))
    )
    until = _SETTLED if request.variant == "settling" else np.inf

    def encoders(t: Array, q: Array, noise: Array) -> Array:
        return np.asarray(
            read_angles_with_noise(t, q, noise) + np.where(t < until, 1.0, 0.0)[:, None] * offset
        )

    return ScenarioPlan(
        stand_still(np.array(request.arm.home)),
        0.02,
        encoders,
        plan_strokes(request, 3.0, lambda: 0.0),
    )


SCENARIO = Scenario(
    "encoders wrong for 0.5 s, or for good",
    _plan_biased_start,
    20.0,
    variants=("settling", "constant"),
)

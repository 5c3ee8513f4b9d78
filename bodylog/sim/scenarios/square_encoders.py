"""Encoders that read the square of the angle: its size is identifiable, its sign is not."""

import numpy as np

from ...types import Array
from ..motion import stand_still
from ..plan import Request, Scenario, ScenarioPlan, plan_exploration, swing_of_joints


def _plan_square_encoders(request: Request) -> ScenarioPlan:
    squared = swing_of_joints(request) > 0

    def encoders(t: Array, q: Array, noise: Array) -> Array:
        return np.where(squared, q**2, q) + noise

    if request.variant == "moving":
        return ScenarioPlan(plan_exploration(request, swing_of_joints(request)), 0.003, encoders)
    return ScenarioPlan(stand_still(np.array(request.arm.home)), 0.01, encoders)


SCENARIO = Scenario(
    "encoders read x squared", _plan_square_encoders, 15.0, variants=("still", "moving")
)

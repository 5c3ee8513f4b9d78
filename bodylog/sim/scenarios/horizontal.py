"""Exploration that never moves the elbow, about which vision then gives no information."""

import numpy as np

from ..plan import (
    Request,
    Scenario,
    ScenarioPlan,
    plan_exploration,
    read_angles_with_noise,
    swing_of_joints,
)


def _plan_horizontal(request: Request) -> ScenarioPlan:
    reach = swing_of_joints(request)
    reach[request.arm.elbow] = 0.0
    return ScenarioPlan(
        plan_exploration(request, reach * np.where(reach == reach.max(), 1.0, 0.5)),
        0.003,
        read_angles_with_noise,
    )


SCENARIO = Scenario("exploration that does not move the elbow", _plan_horizontal, 40.0)

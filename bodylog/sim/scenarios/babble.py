"""Exploration to learn a body: mostly sideways, with enough lift and elbow to learn them too."""

from ..plan import (
    Request,
    Scenario,
    ScenarioPlan,
    plan_exploration,
    read_angles_with_noise,
    swing_of_joints,
)

_FOUR = (0, 1, 2, 3)


def _plan_babble(request: Request) -> ScenarioPlan:
    joints = _FOUR if request.variant == "four" else None
    return ScenarioPlan(
        plan_exploration(request, swing_of_joints(request, joints)), 0.003, read_angles_with_noise
    )


SCENARIO = Scenario("exploration, quiet encoders", _plan_babble, 40.0, variants=("usual", "four"))

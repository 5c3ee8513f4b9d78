"""Smooth reaching; a card hides the end effector for two seconds in the middle."""

from ..plan import (
    Request,
    Scenario,
    ScenarioPlan,
    plan_reaches,
    read_angles_with_noise,
    swing_of_joints,
)

_FOUR = (0, 1, 2, 3)


def _plan_reach(request: Request) -> ScenarioPlan:
    joints = _FOUR if request.variant == "four" else None
    middle = request.duration / 2
    return ScenarioPlan(
        plan_reaches(request, swing_of_joints(request, joints)),
        0.02,
        read_angles_with_noise,
        covered=(middle - 1.0, middle + 1.0),
    )


SCENARIO = Scenario(
    "smooth reaching, hidden for 2 s", _plan_reach, 20.0, variants=("usual", "four")
)

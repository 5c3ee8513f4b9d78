"""Smooth reaching; a card hides the end effector for two seconds in the middle."""

from ..plan import Plan, Request, Scenario, plain, reach, swing

_FOUR = (0, 1, 2, 3)


def _plan(request: Request) -> Plan:
    joints = _FOUR if request.variant == "four" else None
    middle = request.duration / 2
    return Plan(reach(request, swing(request, joints)), 0.02, plain, covered=(middle - 1.0, middle + 1.0))


SCENARIO = Scenario("smooth reaching, hidden for 2 s", _plan, 20.0, variants=("usual", "four"))

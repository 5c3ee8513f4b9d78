"""Exploration for learning a body: mostly sideways, with enough lift and elbow to learn them too."""

from ..plan import Plan, Request, Scenario, explore, plain, swing

_FOUR = (0, 1, 2, 3)


def _plan(request: Request) -> Plan:
    joints = _FOUR if request.variant == "four" else None
    return Plan(explore(request, swing(request, joints)), 0.003, plain)


SCENARIO = Scenario("exploration, quiet encoders", _plan, 40.0, variants=("usual", "four"))

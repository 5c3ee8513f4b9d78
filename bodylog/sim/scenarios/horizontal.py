"""Exploration that never moves the elbow, about which vision then gives no information."""

import numpy as np

from ..plan import Plan, Request, Scenario, explore, plain, swing


def _plan(request: Request) -> Plan:
    reach = swing(request)
    reach[request.arm.elbow] = 0.0
    return Plan(explore(request, reach * np.where(reach == reach.max(), 1.0, 0.5)), 0.003, plain)


SCENARIO = Scenario("exploration that does not move the elbow", _plan, 40.0)

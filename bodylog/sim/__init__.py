"""Sim: a simulated robot arm, recorded as an ordinary log with ground truth."""

from .record import record_scenario
from .scenarios import SCENARIOS
from .world import how_to_install

__all__ = ["SCENARIOS", "how_to_install", "record_scenario"]

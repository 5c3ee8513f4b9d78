"""Sim: a simulated robot arm, recorded as an ordinary log with ground truth."""

from .record import record_scenario
from .scenarios import SCENARIOS

__all__ = ["SCENARIOS", "record_scenario"]

"""Sim: a robot arm that exists only on the processor, recorded as an ordinary log with the truth beside it."""

from .record import record
from .scenarios import SCENARIOS
from .world import how_to_install

__all__ = ["SCENARIOS", "how_to_install", "record"]

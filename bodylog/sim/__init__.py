"""Sim: a robot arm that exists only on the processor, recorded as an ordinary log with the truth beside it."""

from .record import record
from .scenarios import SCENARIOS

__all__ = ["SCENARIOS", "record"]

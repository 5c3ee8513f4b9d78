"""The interface of a sense: one function that reads all its measurements."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from ...body_model import BodyModel
from ...types import Features, Health
from .records import Sighting


class Measured(NamedTuple):
    """Measurements of one name (t (N,) · values (N,D) ·
    cov (N,D,D) or var (N,D) · model), and counts of use.
    """

    sighting: Sighting
    health: Health


Sense = Callable[[Features, BodyModel], Mapping[str, Measured]]
"""Reads, by name, what the features contain and the body predicts, with any number of rows D."""


def build_health(seen: int, used: int, reasons: Mapping[str, int], gap: float = 0.0) -> Health:
    """Counts of use, without the reasons of no rejection; gap: the largest, in s."""
    return Health(
        seen, int(used), {reason: int(count) for reason, count in reasons.items() if count}, gap
    )

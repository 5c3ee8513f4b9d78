"""What a method of estimation is: one function from features to an estimate, and what it can do."""

from collections.abc import Callable
from typing import NamedTuple

from ...body_model import BodyModel
from ...settings import Estimation
from ...types import Capabilities, Estimate, Features

SENSES = frozenset({"encoders", "vision", "touch"})
"""Groups of senses."""
VARIANCES = frozenset({"sigma_encoders", "sigma_vision", "sigma_touch", "process"})
"""Settings that are variances."""


class Method(NamedTuple):
    """One `--method`: its function, what it can do, the senses it can use, the settings it obeys.

    heeds: settings beside method, senses, rate and start · literal_touch: it can take touch as printed in the paper ·
    encoder_model: it uses the body's own model of what encoders read, where that is no angle · live: it needs nothing
    of the whole log, so that it runs beside a robot.
    """

    estimate: Callable[[Features, BodyModel, Estimation], Estimate]
    can: Capabilities
    senses: frozenset[str] = SENSES
    heeds: frozenset[str] = frozenset({"precision", "bias", *VARIANCES})
    literal_touch: bool = False
    encoder_model: bool = False
    live: bool = False
